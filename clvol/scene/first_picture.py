"""Fills in what a scene leaves out, from the volume: see ``clvol/choice``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from clvol.choice.first_picture import FirstPicture, Wanted, lights_for, tables_of
from clvol.scene.camera import Camera
from clvol.scene.integration import Integration
from clvol.scene.light import Light
from clvol.scene.material import Material
from clvol.scene.transfer_function import TransferFunctionSettings

if TYPE_CHECKING:
    from clvol.choice.look import Look
    from clvol.choice.view import View
    from clvol.scene.scene import Scene


def completed(scene: Scene, memory_cap: int | None = None) -> Scene:
    """``scene`` with a transfer function, and with the lights, material, filter, background and camera that it leaves
    out. A scene that has a [transfer_function] is returned as it is. Nothing that the scene states is changed.

    Its ``chosen`` says what was chosen, and why. Raises SceneError, VolumeError.
    """
    if scene.transfer_function is not None:
        return scene
    picture = scene.first_picture(memory_cap)
    wanted = Wanted(
        lit=scene.integration.shades and scene.compression.decode != "resident",
        projects=scene.integration.compositing != "over",
        has_surfaces=bool(scene.isosurface),
    )
    look = picture.look(wanted)
    view = picture.view(picture.natural.points if wanted.has_surfaces or wanted.projects else look.points)
    return _filled_in(scene, picture, look, view)


def _filled_in(scene: Scene, picture: FirstPicture, look: Look, view: View) -> Scene:
    tables = tables_of(look)
    update: dict[str, Any] = {"transfer_function": TransferFunctionSettings(**tables["transfer_function"])}
    if "background" not in scene.image.model_fields_set:
        update["image"] = scene.image.model_copy(update={"background": tuple(look.background)})
    keys = {
        key: value for key, value in tables.get("integration", {}).items()
        if key not in scene.integration.model_fields_set
    }  # fmt: skip
    if scene.integration.prefilter or scene.integration.classification == "pre":
        keys.pop("filter", None)
    if keys:
        update["integration"] = scene.integration.model_copy(update=keys)
    camera = (scene.camera or Camera()).complete(
        picture.volume.grid, scene.image, scene.origin, picture.volume.frame, view
    )
    update["camera"] = camera
    if look.lit and not scene.light and scene.environment is None:
        forward, _, up = camera.basis()
        update["light"] = tuple(Light(**light) for light in lights_for(-forward, up))
    if look.lit and "material" in tables:
        kept = {key: getattr(scene.material, key) for key in scene.material.model_fields_set}
        update["material"] = Material(**{**tables["material"], **kept})
    filled = scene.model_copy(update=update)
    filled._chosen = _chosen(look, view, update)
    return filled


def _chosen(look: Look, view: View, update: dict[str, Any]) -> dict[str, Any]:
    """What ``--stats`` and the printed line say."""
    shown = [value for value, opacity, _ in look.points if opacity > 0]
    facts: dict[str, Any] = {
        "kind": look.kind,
        "why": look.why,
        "visible_values": [float(min(shown)), float(max(shown))] if shown else [],
        "opacity_unit": look.opacity_unit,
        "view": view.why,
        "tables": sorted(update),
    }
    integration = update.get("integration", Integration())
    facts["filter"] = integration.filter
    facts["lights"] = len(update.get("light", ()))
    facts["in_words"] = in_words(facts)
    return facts


def in_words(facts: dict[str, Any]) -> str:
    """One line about what was chosen: ``Scene.chosen``."""
    parts = [f"{facts['kind']} ({facts['why']})"]
    if facts["visible_values"]:
        low, high = facts["visible_values"]
        parts.append(f"visible {low:.6g} to {high:.6g}" if low < high else f"visible {low:.6g}")
    parts.append(f"{facts['lights']} lights" if facts["lights"] else "unlit")
    parts += [f"filter {facts['filter']}", f"view {facts['view']}"]
    return "chosen: " + ", ".join(parts)

