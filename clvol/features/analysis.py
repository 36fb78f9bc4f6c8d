"""One analysis of a scene: the effects that it needs, and the scene without all others.

Both come from the same passes, so they agree. An analysis is cached for the lifetime of its scene.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from weakref import ReferenceType, WeakKeyDictionary, ref

from clvol.features import (
    ambient_occlusion,
    channels,
    clipping,
    depth_cue,
    emission,
    fields,
    filters,
    glow,
    gradients,
    half_angle,
    lighting,
    minification,
    noise,
    opacity,
    refraction,
    segments,
    shadows,
    surfaces,
)
from clvol.features.effect import Effect
from clvol.features.findings import Findings
from clvol.scene.channel_scenes import channel_scenes
from clvol.scene.resolve import ResolvedScene

NAMES = (
    "emission-absorption",
    "projection",
    "integral tables",
    "channels",
    "nearest filter",
    "cubic filter",
    "catmull-rom filter",
    "mitchell filter",
    "lanczos2 filter",
    "lanczos3 filter",
    "windowed-sinc filter",
    "table filter",
    "prefilter",
    "minification",
    "lighting",
    "specular",
    "light at both ends",
    "spot lights",
    "image lights",
    "environment",
    "environment background",
    "shadows",
    "scattering",
    "attenuation noise",
    "half-angle slices",
    "ambient occlusion",
    "isosurfaces",
    "refraction",
    "continuous refraction",
    "gradients",
    "sobel gradients",
    "precomputed gradients",
    "gradient opacity",
    "directional opacity",
    "fur",
    "two-dimensional transfer function",
    "joint transfer function",
    "associated colours",
    "label field",
    "density field",
    "mask field",
    "color field",
    "noise",
    "colour cycling",
    "clipping",
    "depth cueing",
)
# Each pass analyses the scene as reduced by the passes before it.
_PASSES = (
    filters, glow, emission, segments, minification, fields, noise, clipping, surfaces, refraction, opacity, lighting,
    shadows, half_angle, ambient_occlusion, depth_cue, gradients,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Analysis:
    effects: tuple[Effect, ...]
    # None: the scene itself, in which everything has a consequence
    reduced: ResolvedScene | None
    for_frames: ResolvedScene | None  # the same for any time of its animation


_known: WeakKeyDictionary = WeakKeyDictionary()  # ResolvedScene: Analysis
_recent: deque[ReferenceType[ResolvedScene]] = deque(maxlen=4)  # those that were analysed last
# Parts of a scene that no pass looks at, apart from a depth cue at the camera.
_VIEW = ("camera", "source", "display", "overlay")


def analysis_of(scene: ResolvedScene) -> Analysis:
    if scene not in _known and scene.channels:
        found_in = [analysis_of(each).effects for each in channel_scenes(scene)]
        _known[scene] = Analysis(channels.effects_of(found_in, scene), None, None)
    if scene not in _known:
        _known[scene] = _of_another_view(scene) or _analysed(scene)
        _recent.append(ref(scene))
    return _known[scene]


def differs_in_view(one: ResolvedScene, other: ResolvedScene) -> bool:
    """Whether the scenes differ in nothing but the camera, their texts, and how pictures are displayed, so that they
    have the same effects. What they have in common must be the same objects."""
    parts = vars(other)
    same = (part is parts[name] for name, part in vars(one).items() if name not in _VIEW)
    return one.depth_cue is None and all(same)


def _of_another_view(scene: ResolvedScene) -> Analysis | None:
    """The analysis of a scene that differs in its view alone, for ``scene``; None if none is known."""
    for known in _recent:
        other = known()
        if other is not None and other in _known and differs_in_view(scene, other):
            found: Analysis = _known[other]
            view = {name: getattr(scene, name) for name in _VIEW}
            small = None if found.reduced is None else replace(found.reduced, **view)
            later = small if found.for_frames is found.reduced else found.for_frames
            later = later if later is small or later is None else replace(later, **view)
            return Analysis(found.effects, small, later)
    return None


def _analysed(scene: ResolvedScene) -> Analysis:
    found = Findings(scene)
    for part in _PASSES:
        part.analyse(found)
    found.note(channels.effect_of(scene))
    effects = tuple(found.effects[name] for name in NAMES)
    changed = _differs(found.scene, scene)
    small = found.scene if changed else None
    later = small
    if found.cycles_later:
        later = replace(found.scene, animation=scene.animation)
        later = later if _differs(later, scene) else None
    return Analysis(effects, small, later)


def effects(resolved: ResolvedScene) -> list[Effect]:
    """Every effect that clvol knows, with the reason why this scene needs it or does not."""
    return list(analysis_of(resolved).effects)


def called_for(resolved: ResolvedScene) -> list[str]:
    """The names of the effects that the scene needs."""
    return [effect.name for effect in effects(resolved) if effect.called_for]


def reduced(resolved: ResolvedScene) -> ResolvedScene:
    """``resolved`` without everything that has no consequence: it gives exactly the same picture.

    Kernels are chosen and samples taken for the reduced scene. A scene in which nothing is lit has the material
    ``NEUTRAL``. The result is ``resolved`` itself if there is nothing to leave out. It holds for the scene's camera
    and animation only, since a depth cue may depend on them.
    """
    analysis = analysis_of(resolved)
    return resolved if analysis.reduced is None else analysis.reduced


def reduced_for_frames(resolved: ResolvedScene) -> ResolvedScene:
    """As ``reduced``, but colour cycling stays even if the colours are back where they began: it has a consequence in
    the next frame, which must be rendered by the same kernels.
    """
    analysis = analysis_of(resolved)
    return resolved if analysis.for_frames is None else analysis.for_frames


def _differs(one: ResolvedScene, other: ResolvedScene) -> bool:
    names = vars(one)
    return any(getattr(one, name) is not getattr(other, name) for name in names)
