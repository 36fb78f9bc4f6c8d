"""Whether rays of a picture may start where those of the one before first contributed, as far as the scene decides.

Lights, colours, material and background may change: they change what is seen, and not where. So may what makes rays
contribute later: a transfer function that shows fewer values, and iso-values that are raised, for rays that begin below
them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction

_OF_FILTER = ("filter", "filter_table", "filter_reach", "prefilter")


@dataclass(frozen=True, eq=False)
class Facts:
    """What decides where rays of ``scene`` first contribute. ``same``: by name, what must not change.
    ``surfaces``: iso-values of the surfaces that show or bend rays, ascending."""

    scene: ResolvedScene
    same: dict[str, tuple[Any, ...]]
    surfaces: tuple[float, ...]

    @classmethod
    def of(cls, scene: ResolvedScene, contents: bytes = b"") -> Facts:
        """``contents``: what the device holds of the volume, if that changes."""
        integration = scene.integration
        moves = any(any(term.velocity) for term in (*scene.noise, *scene.fur))
        by_gradient = scene.gradient_opacity, scene.directional_opacity
        gradients = any(factor is not None for factor in by_gradient) or scene.transfer_layers or scene.fur
        same = {
            "the volume": (scene.volume,),
            "the blocks": (contents, scene.multiresolution.interblock),
            "the fields": scene.fields,
            "the clips": scene.clips,
            "the noise": (*scene.noise, *scene.fur, scene.animation.time if moves else 0.0),
            "the filter": tuple(getattr(integration, name) for name in _OF_FILTER),
            "the step": (integration.step,),
            "the classification": (integration.classification,),
            "opacity by gradients": (*by_gradient, *scene.transfer_layers, scene.gradient) if gradients else (),
        }
        shown = {s.value for s in scene.isosurfaces if s.opacity > 0 or s.refraction != 1.0}
        return cls(scene, same, tuple(sorted(shown)))

    def reason_afresh(self, before: Facts) -> str | None:
        """Why rays must start at the hull, after a picture of ``before``; None if they need not."""
        for name, parts in self.same.items():
            if not _alike(parts, before.same[name]):
                return f"{name} changed"
        if not shows_no_more(self.scene.transfer_function, before.scene.transfer_function):
            return "the transfer function shows more"
        if self.surfaces and self.surfaces != before.surfaces and not self._is_behind(before):
            return "the iso-values changed"
        return None

    def _is_behind(self, before: Facts) -> bool:
        """Whether rays meet the surfaces of ``before`` before they meet these: they begin below both."""
        scene = self.scene
        if not before.surfaces or self.surfaces[0] < before.surfaces[0]:
            return False
        if self.same["the blocks"][0]:
            return False  # which would have to be read
        if scene.noise or scene.clips or scene.integration.filter not in ("nearest", "linear"):
            return False
        return _largest_on_faces(scene.volume.data) < before.surfaces[0]


def shows_no_more(now: TransferFunction, before: TransferFunction) -> bool:
    """Whether all values that have opacity in ``now`` have some in ``before``."""
    if now is before:
        return True
    nodes = np.unique(np.concatenate([now.values, before.values]))
    between = 0.5 * (nodes[1:] + nodes[:-1])
    outside = [nodes[0] - 1.0, nodes[-1] + 1.0]
    at = np.concatenate([outside, nodes, between])
    return not np.any((now.opacity(at) > 0) & ~(before.opacity(at) > 0))


def _alike(a: tuple[Any, ...], b: tuple[Any, ...]) -> bool:
    """Objects without a value of their own are alike if they are the same."""
    plain = (str, float, int, bytes)
    return len(a) == len(b) and all(
        x is y or (type(x) is type(y) and (isinstance(x, plain) or hasattr(x, "model_fields_set")) and x == y)
        for x, y in zip(a, b)
    )


def _largest_on_faces(data: np.ndarray) -> float:
    """The largest value on the faces of ``data`` [z, y, x]; infinite where one of them is not a number."""
    faces = [data.take(place, axis) for axis in range(3) for place in (0, -1)]
    most = max(float(face.max()) for face in faces)
    return most if np.isfinite(most) else np.inf
