"""All rays of a picture from front to back, a segment at a time."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from reference.block_medium import BlockMediumField
from reference.cell_crossings import medium_crossings
from reference.clip import kept_stretches
from reference.environment import EnvironmentMap
from reference.medium import Medium
from reference.occlusion import Occlusion
from reference.project import Projection
from reference.shade import Shader
from reference.shadow import Shadows
from reference.surfaces import bent

MOST_BENDS = 8
LONGEST_PATH = 8.0  # of rays that turn, in diagonals of the bounding box


def render_twin(
    resolved,
    camera=None,
    *,
    step: float | None = None,
    rays: tuple[np.ndarray, np.ndarray] | None = None,
    noise_tile: np.ndarray | None = None,
    environment_map: np.ndarray | None = None,
    field: BlockMediumField | None = None,
) -> np.ndarray:
    """The picture of ``resolved``, premultiplied linear RGBA, float64 [height, width, 4].

    ``camera``: another, complete one. ``step``: in smallest voxel edges, instead of the scene's.
    ``rays``: world origins and unit directions, float64 [..., 3] each, instead of the camera's:
    then [..., 4]. ``noise_tile`` uint8 [z, y, x, 4] and ``environment_map`` [h, w, 3] instead of
    what the scene names. ``field``: in place of the volume's reconstruction.
    """
    if rays is None:
        camera = camera or resolved.camera
        rays = camera.world_rays(resolved.image.width, resolved.image.height)
    shape = rays[0].shape[:-1]
    origin, direction = (np.asarray(part, np.float64).reshape(-1, 3) for part in rays)
    march = _March(resolved, step, noise_tile, environment_map, field)
    return march.render(origin, direction).reshape(*shape, 4)


@dataclass
class _Rays:
    """The state of n rays: where they are (``i`` segments into stretch ``slot``), what they
    gathered, and on which side of each surface they are known to start (0: not known)."""

    origin: np.ndarray
    direction: np.ndarray
    kept: object
    side: np.ndarray
    travelled: np.ndarray = dataclasses.field(init=False)  # world length before origin, of a bent ray
    travelled0: np.ndarray = dataclasses.field(init=False)  # and to where the ray entered the volume
    slot: np.ndarray = dataclasses.field(init=False)
    i: np.ndarray = dataclasses.field(init=False)
    bends: np.ndarray = dataclasses.field(init=False)
    alive: np.ndarray = dataclasses.field(init=False)
    color: np.ndarray = dataclasses.field(init=False)
    opacity: np.ndarray = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        n = len(self.origin)
        self.travelled, self.opacity, self.color = np.zeros(n), np.zeros(n), np.zeros((n, 3))
        self.slot, self.i, self.bends = (np.zeros(n, int) for _ in range(3))
        self.alive = np.isfinite(self.kept.enter[:, 0])
        self.travelled0 = np.where(self.alive, self.kept.enter[:, 0], 0.0)

    def at(self, rays: np.ndarray, t: np.ndarray) -> np.ndarray:
        return self.origin[rays] + t[:, None] * self.direction[rays]

    def composite(self, rays: np.ndarray, color: np.ndarray, opacity: np.ndarray) -> None:
        weight = (1.0 - self.opacity[rays]) * opacity
        self.color[rays] += weight[:, None] * color
        self.opacity[rays] += weight


class _March:
    def __init__(self, resolved, step, noise_tile, environment_map, field) -> None:
        self.resolved = resolved
        integration = resolved.integration
        self.mode = getattr(integration, "compositing", "over")
        self.medium = Medium(resolved, noise_tile, field)
        self.step = (step or integration.step) * self.medium.grid.smallest_edge
        self.stop = 1.0 - integration.early_termination
        self.environment = _environment(resolved.environment, environment_map)
        self.index = resolved.refraction if self.mode == "over" else None
        self.longest = LONGEST_PATH * np.linalg.norm(np.ptp(self.medium.grid.world_corners(), axis=0))
        self.surfaces = resolved.isosurfaces if self.mode == "over" else ()
        shadows = None if resolved.shadow is None else Shadows(resolved, self.medium, step)
        over = self.mode == "over" and resolved.ambient_occlusion is not None
        occlusion = Occlusion(resolved, self.medium) if over else None
        self.shader = Shader(resolved, self.environment, shadows, occlusion)

    def render(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        grid, clips = self.medium.grid, self.resolved.clips
        kept = kept_stretches(grid, clips, origin, direction)
        side = np.zeros((len(origin), len(self.surfaces)), int)
        rays = _Rays(origin.copy(), direction.copy(), kept, side)
        if self.index is not None and not clips:
            entering = np.nonzero(rays.alive)[0]
            self._turn(rays, entering, kept.enter[entering, 0].copy(), 0.5 * self.step)
        projection = None
        if self.mode != "over":
            attenuation = self.resolved.integration.attenuation
            projection = Projection(self.mode, attenuation, self.medium, len(origin))
        while rays.alive.any():
            self._advance(rays, np.nonzero(rays.alive)[0], projection)
        rgba = np.column_stack([rays.color, rays.opacity])
        if projection is not None:
            rgba = projection.rgba()
        if self.environment is not None and self.resolved.environment.visible:
            behind = self.environment.radiance(rays.direction)
            rgba[:, :3] += (1.0 - rgba[:, 3:]) * behind
            rgba[:, 3] = 1.0
        return rgba

    def _advance(self, rays: _Rays, n: np.ndarray, projection) -> None:
        """One segment of each of the rays numbered ``n``."""
        enter, leave = rays.kept.enter[n, rays.slot[n]], rays.kept.leave[n, rays.slot[n]]
        t0 = enter + rays.i[n] * self.step
        t1 = np.minimum(enter + (rays.i[n] + 1) * self.step, leave)
        if projection is not None:
            projection.add(n, rays.at(n, t0), rays.at(n, t1))
            bent_rays = np.zeros(len(n), bool)
        elif self.surfaces:
            bent_rays = self._segment_with_surfaces(rays, n, t0, t1)
        else:
            color, depth = self._look(rays, n, t0, t1)
            rays.composite(n, color, -np.expm1(-depth))
            bent_rays = np.zeros(len(n), bool)
            if self.index is not None:
                on = (t1 < leave) & (rays.travelled[n] + t1 < rays.travelled0[n] + self.longest)
                on &= rays.opacity[n] < self.stop
                bent_rays[on] = self._turn(rays, n[on], t1[on], self.step)
        on, t1, leave = n[~bent_rays], t1[~bent_rays], leave[~bent_rays]
        rays.i[on] += 1
        ended = on[t1 >= leave]
        rays.slot[ended] += 1
        rays.i[ended] = 0
        last = rays.slot >= rays.kept.enter.shape[1]
        rays.slot[last] = rays.kept.enter.shape[1] - 1
        rays.alive &= ~last & np.isfinite(rays.kept.enter[np.arange(len(last)), rays.slot])
        rays.alive &= rays.opacity < self.stop

    def _segment_with_surfaces(self, rays, n, t0, t1) -> np.ndarray:
        """A segment cut at its crossings; which of the rays ``n`` were bent."""
        met = medium_crossings(
            self.medium, rays.origin[n], rays.direction[n], t0, t1,
            [surface.value for surface in self.surfaces],
            known_side=np.where((rays.i[n] == 0)[:, None], rays.side[n], 0),
        )  # fmt: skip
        color, depth = self._look(rays, n, t0, t1)
        depth_per_length = depth / np.where(t1 > t0, t1 - t0, 1.0)
        going, was_bent = np.ones(len(n), bool), np.zeros(len(n), bool)
        start = t0
        for k in range(met.t.shape[1] + 1):
            at = met.t[:, k] if k < met.t.shape[1] else np.full(len(n), np.inf)
            end = np.minimum(at, t1)
            here = going & (end > start)
            opacity = -np.expm1(-depth_per_length * (end - start))
            rays.composite(n[here], color[here], opacity[here])
            going &= np.isfinite(at) & (rays.opacity[n] < self.stop)
            if going.any():
                surface, rising = met.surface[going, k], met.rising[going, k]
                was_bent[going] = self._surface(rays, n[going], at[going], surface, rising)
                going &= ~was_bent & (rays.opacity[n] < self.stop)
            start = end
        return was_bent

    def _look(self, rays, n, t0, t1) -> tuple[np.ndarray, np.ndarray]:
        """(colour [n, 3], lit and cued, optical depth [n]) of the volume from t0 to t1."""
        enter = rays.kept.enter[n, rays.slot[n]]
        segment = self.medium.segment(
            rays.at(n, t0), rays.at(n, t1), rays.direction[n],
            before=rays.at(n, t0 - self.step), curved=rays.i[n] > 0, steps=(t1 - t0) / self.step,
        )  # fmt: skip
        normal = rays.kept.normal[n, rays.slot[n]]
        tm = 0.5 * (t0 + t1)
        share = np.clip(1.0 - (tm - enter) / self.medium.grid.smallest_edge, 0.0, 1.0)
        share = np.where(np.any(normal != 0, axis=1), share, 0.0)
        weight = -np.expm1(-segment.depth) * (1.0 - rays.opacity[n])
        color, seen = segment.color.copy(), segment.depth > 0
        if self.medium.lit_at_ends:
            color[seen] = self._lit_at_ends(rays, n, seen, t0, t1, color, weight, normal, segment.place)
        else:
            color[seen] = self.shader.lit(
                color[seen], segment.middle[seen], segment.gradient[seen], rays.direction[n[seen]],
                weight=weight[seen], cut_normal=normal[seen], cut_share=share[seen],
            )  # fmt: skip
        depth = segment.depth
        if self.medium.glow is not None:  # light without opacity is that of hardly any
            depth = np.maximum(depth, 1e-30)
            color = np.where(seen[:, None], color, 0.0) + segment.light / depth[:, None]
        return self._cued(color, rays.travelled[n] + tm), depth

    def _lit_at_ends(self, rays, n, seen, t0, t1, color, weight, normal, place) -> np.ndarray:
        """Colours [m, 3] of the segments that are ``seen``, lit at both ends and weighed by their ``place`` between."""
        enter, ends = rays.kept.enter[n, rays.slot[n]], []
        for t in (t0, t1):
            at = rays.at(n, t)[seen]
            share = np.clip(1.0 - (t - enter) / self.medium.grid.smallest_edge, 0.0, 1.0)
            share = np.where(np.any(normal != 0, axis=1), share, 0.0)[seen]
            ends.append(self.shader.lit(
                color[seen], at, self.medium.gradient(at), rays.direction[n[seen]], weight=weight[seen],
                cut_normal=normal[seen], cut_share=share,
            ))  # fmt: skip
        return ends[0] + place[seen, None] * (ends[1] - ends[0])

    def _surface(self, rays, n, t, surface, rising) -> np.ndarray:
        """Composites crossings of the rays ``n`` at ``t``; which of them were bent there.

        A mask removes surfaces too.
        """
        at = rays.at(n, t)
        kept = self.medium.is_kept(at)
        gradient = self.medium.gradient(at)
        front = np.array([s.color for s in self.surfaces], float)[surface]
        back = np.array([s.back_color for s in self.surfaces], float)[surface]
        opacity = np.array([s.opacity for s in self.surfaces], float)[surface] * kept
        index = np.array([s.refraction for s in self.surfaces], float)[surface]
        color = self.shader.lit(
            np.where(rising[:, None], front, back), at, gradient, rays.direction[n],
            weight=opacity * (1.0 - rays.opacity[n]), surface=surface,
        )  # fmt: skip
        rays.composite(n, self._cued(color, rays.travelled[n] + t), opacity)
        bends = kept & (index != 1.0) & (rays.bends[n] < MOST_BENDS)
        bends &= (rays.opacity[n] < self.stop) & np.any(gradient != 0, axis=1)
        bends &= np.isfinite(gradient).all(axis=1)
        if bends.any():
            direction, reflected = bent(rays.direction[n], gradient, index, rising)
            side = np.where(rising != reflected, 1, -1)
            self._restart(
                rays, n[bends], at[bends], direction[bends], t[bends], surface[bends], side[bends]
            )
        return bends

    def _turn(self, rays, n, t, way) -> np.ndarray:
        """Turns the rays ``n`` at ``t``, after which they go ``way`` as if the gradient of the index there stayed;
        which of them turn. The angle to that gradient, whose half's tangent shrinks by exp(-|g| way / n), says so."""
        at = rays.at(n, t)
        value, gradient = self.medium.value(at), self.medium.gradient(at)
        gradient = np.where(np.isfinite(gradient).all(axis=1)[:, None], gradient, 0.0)
        turn = gradient * (self.index.slope(value) * way / self.index(value))[:, None]
        size, direction = np.linalg.norm(turn, axis=1), rays.direction[n]
        turns = size > 0
        axis = turn / np.where(turns, size, 1.0)[:, None]
        along = np.clip(np.sum(axis * direction, axis=1), -1, 1)
        across = direction - along[:, None] * axis
        sine = np.linalg.norm(across, axis=1)
        half = np.arctan2(sine, 1.0 + along)  # half the angle to the gradient
        tanh = 0.5 * size / np.sqrt(1.0 + (0.5 * size) ** 2)  # of half the turn, as the kernels shorten it
        new = 2.0 * np.arctan(np.tan(half) * (1.0 - tanh) / (1.0 + tanh))
        side = across / np.where(sine > 0, sine, 1.0)[:, None]
        bent = np.cos(new)[:, None] * axis + np.sin(new)[:, None] * side
        if turns.any():
            self._go_on(rays, n[turns], at[turns], bent[turns], t[turns])
        return turns

    def _go_on(self, rays, n, at, direction, t) -> None:
        """Rays ``n`` go on from ``at`` in another direction."""
        rays.origin[n], rays.direction[n] = at, direction
        rays.travelled[n] += t
        kept = kept_stretches(self.medium.grid, self.resolved.clips, at, direction)
        rays.kept.enter[n], rays.kept.leave[n] = kept.enter, kept.leave
        rays.kept.normal[n] = kept.normal
        rays.slot[n] = rays.i[n] = 0
        rays.alive[n] &= np.isfinite(kept.enter[:, 0])

    def _restart(self, rays, n, at, direction, t, surface, side) -> None:
        """Rays ``n`` go on from ``at`` in another direction."""
        self._go_on(rays, n, at, direction, t)
        rays.bends[n] += 1
        rays.side[n] = 0
        rays.side[n, surface] = side

    def _cued(self, color: np.ndarray, distance: np.ndarray) -> np.ndarray:
        cue = self.resolved.depth_cue
        if cue is None:
            return color
        share = np.clip((distance - cue.start) / (cue.end - cue.start), 0.0, 1.0) * cue.strength
        return color + share[:, None] * (np.asarray(cue.color, float) - color)


def _environment(settings, texels) -> EnvironmentMap | None:
    if settings is None or settings.intensity == 0:
        return None
    if texels is None:
        from clvol.image import exr

        texels = exr.read(str(settings.path))[0][..., :3]
    return EnvironmentMap(
        texels, settings.layout, settings.intensity, settings.rotation_degrees
    )
