"""Lights, highlights and the environment."""

from __future__ import annotations

from clvol.errors import SceneError
from clvol.features.effect import counted, joined, no, yes
from clvol.features.findings import NOTHING_VISIBLE, Findings, has_background
from clvol.features.gradients_exist import opacity_meets_gradient
from clvol.scene.light import Light
from clvol.scene.material import Material
from clvol.scene.resolve import ResolvedScene

NEUTRAL = Material(ambient=1.0, diffuse=0.0, specular=0.0)  # lit samples keep their colour
_BLACK = "every light is black or of intensity 0"
ENDS = "light at both ends"
AIMED = {"spot": "spot lights", "image": "image lights"}


def is_lit(scene: ResolvedScene) -> bool:
    """Whether anything is lit in a *reduced* scene. If not, the material is NEUTRAL, although an environment may
    remain as background.
    """
    return bool(scene.lights or scene.environment) and scene.material != NEUTRAL


def analyse(found: Findings) -> None:
    scene = found.scene
    material, environment = scene.material, scene.environment
    lights = tuple(_all_around(light) for light in scene.lights if _shines(light))
    shines = environment is not None and environment.intensity > 0
    idle = _why_unlit(found, lights, shines)
    found.lit = idle is None
    found.by_lights = found.lit and bool(lights) and _reflects(material)
    reflects_environment = found.lit and shines and _reflects(material)

    if idle is None:
        sources = [counted(len(lights), "light")] if lights else []
        sources += ["an environment"] if shines else []
        found.note(yes("lighting", " and ".join(sources)))
    else:
        found.note(no("lighting", idle))
    _note_specular(found, idle)
    _note_aimed(found, lights, idle)
    _note_environment(found, idle, reflects_environment)

    background = has_background(scene)
    only_ambient = found.lit and not lights and not _reflects(material)
    kept = environment if background or reflects_environment or only_ambient else None
    found.change(
        lights=lights if found.lit else (),
        environment=kept,
        material=_material(material) if found.lit else NEUTRAL,
    )
    _note_ends(found, idle)


def _shines(light: Light) -> bool:
    return light.intensity > 0 and any(light.color) and not (light.type == "spot" and light.cone_degrees == 0)


def _all_around(light: Light) -> Light:
    """``light``; of a spot that shines in all directions alike, the point light that it is."""
    if light.type != "spot" or light.cone_degrees < 180 or light.penumbra > 0:
        return light
    kept = {key: getattr(light, key) for key in ("position", "color", "intensity", "casts_shadow")}
    return Light(type="point", **kept)


def _reflects(material: Material) -> bool:
    return material.diffuse > 0 or material.specular > 0


def _material(material: Material) -> Material:
    """``material`` with defaults for keys that are not read."""
    if material.specular == 0 and material.shininess != Material().shininess:
        return material.model_copy(update={"shininess": Material().shininess})
    return material


def _why_unlit(found: Findings, lights: tuple[Light, ...], shines: bool) -> str | None:
    scene = found.scene
    if not scene.lights and scene.environment is None:
        return "the scene has no light"
    if not lights and not shines:
        dark = any(light.type == "spot" and light.cone_degrees == 0 for light in scene.lights)
        reasons = [_BLACK + (", or a spot whose cone is 0" if dark else "")] if scene.lights else []
        reasons += ["the environment's intensity is 0"] if scene.environment is not None else []
        return joined(reasons)
    if found.projection:
        return f"{found.projection} is not lit"
    if found.blank:
        return NOTHING_VISIBLE
    if scene.material.ambient == 1 and not _reflects(scene.material):
        return "ambient is 1, diffuse and specular are 0"
    if any(surface.opacity > 0 for surface in found.surfaces):
        return None
    if scene.clips and (found.emits or found.adds):  # faces of clips have their own normals
        return None
    if (found.emits or found.adds) and opacity_meets_gradient(scene, anywhere=found.adds):
        return None
    return "no voxel has both opacity and a gradient"


def _note_specular(found: Findings, idle: str | None) -> None:
    if found.scene.material.specular == 0:
        found.note(no("specular", "specular is 0"))
    elif idle is not None:
        found.note(no("specular", idle))
    else:
        found.note(yes("specular", f"specular is {found.scene.material.specular:g}"))


def _note_ends(found: Findings, idle: str | None) -> None:
    """Whether segments are lit at both ends."""
    scene = found.scene
    reason = idle
    if scene.material.light_at == "middle" and idle is None:
        reason = "segments are lit in their middle"
    elif idle is None and scene.integration.classification != "preintegrated":
        reason = f"the classification is {scene.integration.classification!r}, whose segments have one value"
    elif idle is None and not (found.emits or found.adds):
        reason = "nothing but surfaces is lit"
    if reason is None:
        found.note(yes(ENDS, "pre-integrated segments are lit at both ends"))
        return
    found.note(no(ENDS, reason))
    if scene.material.light_at != "middle":
        found.change(material=scene.material.model_copy(update={"light_at": "middle"}))


def check_light_at(resolved: ResolvedScene) -> None:
    """SceneError for what light at both ends of segments cannot be combined with."""
    integration = resolved.integration
    if resolved.material.light_at != "ends" or integration.classification != "preintegrated":
        return
    wrong = (
        ("transfer_layer", "layers", bool(resolved.transfer_layers), "no layers"),
        ("integration.segments", integration.segments, integration.segments != "pieces", "'pieces'"),
        ("isosurface", "surfaces", bool(resolved.isosurfaces), "no surfaces, which cut segments"),
    )
    for key, got, applies, expected in wrong:
        if applies:
            raise SceneError(f"{resolved.origin}: {key}", f"got {got!r} with material.light_at 'ends'", expected)


def _note_aimed(found: Findings, lights: tuple[Light, ...], idle: str | None) -> None:
    for kind, name in AIMED.items():
        given = [light for light in found.scene.lights if light.type == kind]
        left = [light for light in lights if light.type == kind]
        if not given:
            found.note(no(name, f"the scene has no {kind} light"))
        elif idle is not None or not _reflects(found.scene.material):
            found.note(no(name, idle or "diffuse and specular are 0"))
        elif not left:
            found.note(no(name, f"every {kind} light is dark, has a cone of 0, or shines in all directions alike"))
        else:
            found.note(yes(name, counted(len(left), f"{kind} light")))


def _note_environment(found: Findings, idle: str | None, reflected: bool) -> None:
    name, behind = "environment", "environment background"
    environment = found.scene.environment
    if environment is None:
        reason = "the scene has no environment"
        found.note(no(name, reason), no(behind, reason))
        return
    if environment.intensity == 0:
        reason = "the environment's intensity is 0"
        found.note(no(name, reason), no(behind, reason))
        return
    if reflected:
        found.note(yes(name, "the environment lights what has a gradient"))
    else:
        found.note(no(name, idle or "diffuse and specular are 0"))
    if environment.visible:
        found.note(yes(behind, "the environment is visible"))
    else:
        found.note(no(behind, "the environment is not visible"))
