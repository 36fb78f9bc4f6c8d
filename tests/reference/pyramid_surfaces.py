"""The iso-surfaces of the method "pyramid": where the rays of all pixels meet them, and what is seen there."""

from __future__ import annotations

import numpy as np

from clvol.scene.resolve import ResolvedScene
from reference.cell_crossings import medium_crossings
from reference.medium import Medium
from reference.shade import Shader


class PixelSurfaces:
    """The surfaces of a picture's pixels [h, w], in order along each ray. ``next`` [h, w]: how far away (world) the
    next one is, infinite where there is none."""

    def __init__(
        self, resolved: ResolvedScene, medium: Medium, shader: Shader, origin: np.ndarray, direction: np.ndarray
    ) -> None:
        self.resolved, self.medium, self.shader = resolved, medium, shader
        self.origin, self.direction = origin, direction
        surfaces = resolved.isosurfaces
        self.values = [surface.value for surface in surfaces]
        self.opacities = np.array([surface.opacity for surface in surfaces], float)
        sides = (
            [surface.color for surface in surfaces],
            [surface.back_color for surface in surfaces],
        )
        self.front, self.back = (np.array(colors, float) for colors in sides)

    def find(self, pixels: np.ndarray, enter: np.ndarray, leave: np.ndarray) -> None:
        """Finds those of ``pixels`` between ``enter`` and ``leave`` (world lengths)."""
        met = medium_crossings(
            self.medium, self.origin[pixels], self.direction[pixels], enter[pixels], leave[pixels], self.values
        )
        count = met.t.shape[1] + 1
        self.t = np.full((*pixels.shape, count), np.inf)
        self.surface, self.rising = np.zeros(self.t.shape, int), np.zeros(self.t.shape, bool)
        self.t[pixels, :-1], self.surface[pixels, :-1], self.rising[pixels, :-1] = met.t, met.surface, met.rising
        self.passed = np.zeros(pixels.shape, int)

    @property
    def next(self) -> np.ndarray:
        return np.take_along_axis(self.t, self.passed[..., None], axis=-1)[..., 0]

    def pass_next(self, pixels: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(colour [n, 3], lit and cued, opacity [n]) of the next surface of ``pixels``, where ``left`` [n] arrives
        from; the one after it is the next then."""
        slot = self.passed[pixels][:, None]
        t, surface, rising = (
            np.take_along_axis(of[pixels], slot, axis=1)[:, 0] for of in (self.t, self.surface, self.rising)
        )
        at = self.origin[pixels] + t[:, None] * self.direction[pixels]
        opacity = self.opacities[surface]
        color = self.shader.lit(
            np.where(rising[:, None], self.front[surface], self.back[surface]), at, self.medium.gradient(at),
            self.direction[pixels], weight=opacity * left, surface=surface,
        )  # fmt: skip
        self.passed[pixels] += 1
        return cued(self.resolved.depth_cue, color, t), opacity


def cued(cue, color: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """``color`` [n, 3] at ``distance`` [n] under a depth cue, or none."""
    if cue is None:
        return color
    share = np.clip((distance - cue.start) / (cue.end - cue.start), 0.0, 1.0) * cue.strength
    return color + share[:, None] * (np.asarray(cue.color, float) - color)
