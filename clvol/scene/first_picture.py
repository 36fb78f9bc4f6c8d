"""Fills in what a scene leaves out, from the volume: see ``clvol/choice``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.choice.first_picture import FirstPicture, Wanted, lights_for, tables_of
from clvol.choice.look import Look, Point, balanced_unit, mean_edge
from clvol.scene.camera import Camera
from clvol.scene.default_unit import default_opacity_unit
from clvol.scene.integration import Integration
from clvol.scene.light import Light
from clvol.scene.material import Material
from clvol.scene.preset_file import PresetFile, load_preset
from clvol.scene.transfer_function import ControlPoint, TransferFunctionSettings

if TYPE_CHECKING:
    from clvol.choice.view import View
    from clvol.scene.scene import Scene


def completed(scene: Scene, memory_cap: int | None = None) -> Scene:
    """``scene`` with a transfer function, and with the lights, material, filter, background and camera that it leaves
    out. A scene whose [transfer_function] has points or a plain preset is returned as it is; of a preset that is a file
    the function is placed on the volume, and its technique is used. Nothing that the scene states is changed.

    Its ``chosen`` says what was chosen, and why. Raises SceneError, VolumeError.
    """
    given = scene.transfer_function
    picture = scene.first_picture(memory_cap)
    wanted = Wanted(
        lit=scene.integration.shades and scene.compression.decode != "resident",
        projects=scene.integration.compositing != "over",
        has_surfaces=bool(scene.isosurface),
    )
    if given is not None:
        assert isinstance(given, TransferFunctionSettings) and given.preset is not None
        look, more = _preset_look(scene, given, picture, wanted)
        return _filled_in(scene, picture, look, picture.view(look.points), more)
    look = picture.look(wanted)
    view = picture.view(picture.natural.points if wanted.has_surfaces or wanted.projects else look.points)
    return _filled_in(scene, picture, look, view, {})


def _preset_look(
    scene: Scene, given: TransferFunctionSettings, picture: FirstPicture, wanted: Wanted
) -> tuple[Look, dict[str, Any]]:
    """The look of a preset that is a file, placed on the volume, and what ``chosen`` says about it."""
    name = str(given.preset)
    preset = load_preset(name, scene.folder, scene.origin)
    kind = picture.natural.kind
    more: dict[str, Any] = {"preset": name, "scale": preset.scale, "expects": preset.expects}
    offset = 0.0
    if preset.scale == "hounsfield":
        found = picture.hounsfield_offset
        offset = found or 0.0
        more["recognised"] = found is not None
    elif preset.kinds and kind not in preset.kinds:
        more["warning"] = f"{name!r} is for {preset.expects}, but the volume looks like: {kind} ({picture.natural.why})"
    places = [(point.at, point.opacity, point.color) for point in preset.points]
    points = picture.placed(places, preset.scale, offset)
    look = Look(
        kind=kind,
        why=f"preset {name}",
        points=points,
        opacity_unit=_preset_unit(given, preset, picture, points),
        lit=preset.lit and wanted.lit and not wanted.projects,
        integration={key: getattr(preset.integration, key) for key in preset.integration.model_fields_set},
        material=preset.material.model_dump(exclude_unset=True),
        background=picture.natural.background,
    )
    return (look if wanted.lit else replace(look, integration={}, material={})), more


def _preset_unit(
    given: TransferFunctionSettings, preset: PresetFile, picture: FirstPicture, points: Sequence[Point]
) -> float:
    if given.opacity_unit is not None:
        return given.opacity_unit
    if preset.unit_voxels is not None:
        return preset.unit_voxels * mean_edge(picture.sample)
    if preset.mean_opacity is not None and picture.statistics is not None:
        return balanced_unit(picture.statistics, points, preset.mean_opacity)
    return default_opacity_unit(picture.volume.grid)


def _filled_in(scene: Scene, picture: FirstPicture, look: Look, view: View, more: dict[str, Any]) -> Scene:
    tables = tables_of(look)
    tables["transfer_function"]["points"] = tuple(ControlPoint(**p) for p in tables["transfer_function"]["points"])
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
    asked = scene.camera or Camera()
    camera = asked.complete(picture.volume.grid, scene.image, scene.origin, picture.volume.frame, view)
    update["camera"] = camera = rounded(camera, asked)
    if look.lit and not scene.light and scene.environment is None:
        forward, _, up = camera.basis()
        update["light"] = tuple(Light(**light) for light in lights_for(-forward, up))
    if look.lit and "material" in tables:
        kept = {key: getattr(scene.material, key) for key in scene.material.model_fields_set}
        update["material"] = Material(**{**tables["material"], **kept})
    filled = scene.model_copy(update=update)
    filled._chosen = {**_chosen(look, view, update), **more}
    return filled


def rounded(camera: Camera, asked: Camera) -> Camera:
    """``camera`` with what ``asked`` leaves out rounded, so that a scene file states it in a line."""
    distance = float(np.linalg.norm(np.subtract(camera.position or 0.0, camera.target or 0.0)))
    digits = 5 - int(np.floor(np.log10(max(distance, 1e-300))))
    update: dict[str, Any] = {}
    for key in ("position", "target"):
        if getattr(asked, key) is None:
            update[key] = tuple(round(x, digits) + 0.0 for x in getattr(camera, key))
    if asked.up is None and camera.up is not None:
        update["up"] = tuple(round(x, 9) + 0.0 for x in camera.up)
    if asked.height is None and camera.height is not None:
        update["height"] = float(f"{camera.height:.7g}")
    return camera.model_copy(update=update)


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

