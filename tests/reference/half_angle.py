"""Half-angle slices in world coordinates and double precision: light swept through slabs, and what they show."""

from __future__ import annotations

import numpy as np

from clvol.integrators.slicing.half_angle import light_texels
from reference.clip import kept_stretches
from reference.medium import Medium
from reference.shade import Shader
from reference.shadow import CONE_DIRECTIONS, cone_directions


class Slabs:
    """Slabs half way between the light's direction in the middle of the volume and the view's, or the opposite of it:
    a plane is at ``normal`` . p = ``first`` + k ``spacing``."""

    def __init__(self, resolved) -> None:
        grid = resolved.volume.grid
        corners = grid.world_corners()
        middle = corners.mean(axis=0)
        self.light = next((k for k, light in enumerate(resolved.lights) if _casts(light)), None)
        forward = np.asarray(resolved.camera.basis()[0])
        normal = forward
        if self.light is not None:
            light = resolved.lights[self.light]
            way = light.direction if light.type == "directional" else middle - light.position
            way = np.asarray(way, float) / np.linalg.norm(way)
            normal = way + forward if way @ forward >= 0 else way - forward
        self.normal = normal / np.linalg.norm(normal)
        along = corners @ self.normal
        extent = along.max() - along.min()
        spacing = resolved.integration.step * grid.smallest_edge * abs(self.normal @ forward)
        self.count = resolved.slicing.slices or max(1, int(np.ceil(extent / spacing - 1e-6)))
        self.spacing = extent / self.count if resolved.slicing.slices else spacing
        self.first = 0.5 * (along.max() + along.min()) - 0.5 * self.count * self.spacing

    def number(self, at):
        """The number of the slab of places [n, 3], not rounded down."""
        return (at @ self.normal - self.first) / self.spacing

    def pieces(self, origin, direction, enter, leave):
        """Where rays go from slab to slab between ``enter`` and ``leave`` [n]: [n, pieces + 1], ends repeated."""
        start = self.number(origin)
        speed = direction @ self.normal / self.spacing
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (np.arange(self.count + 1) - start[:, None]) / speed[:, None]
        at = np.where(np.isfinite(at), at, enter[:, None])
        return np.sort(np.clip(at, enter[:, None], leave[:, None]), axis=1)


class SlabLight:
    """The light of each slab, as ``Shader`` asks for it."""

    def __init__(self, resolved, medium: Medium, slabs: Slabs) -> None:
        self.slabs = slabs
        shadow, light = resolved.shadow, resolved.lights[slabs.light]
        texels = light_texels(resolved, light)
        self.camera, self.width, self.height = texels.camera, texels.width, texels.height
        origin, direction = self.camera.world_rays(self.width, self.height)
        origin, direction = origin.reshape(-1, 3), direction.reshape(-1, 3)
        kept = kept_stretches(medium.grid, resolved.clips, origin, direction)
        whole = kept_stretches(medium.grid, (), origin, direction)
        own_share = {"middle": 0.5, "front": 0.0}[resolved.slicing.light_at]
        n, s = len(origin), shadow.scattering
        depth, spread = np.zeros(n), np.ones((n, 3))
        less = 1.0 - np.asarray(shadow.scatter_color, float)
        speed = direction @ slabs.normal / slabs.spacing
        start = slabs.number(origin)
        self.light = np.zeros((slabs.count, n, 3))
        hits = np.isfinite(whole.enter[:, 0])
        for k in range(slabs.count):
            begin, end = (k - start) / speed, (k + 1 - start) / speed
            own = np.zeros(n)
            for enter, leave in zip(kept.enter.T, kept.leave.T):
                a, b = np.maximum(begin, enter), np.minimum(end, leave)
                there = np.nonzero(np.isfinite(enter) & (a < b))[0]
                o, d = origin[there], direction[there]
                ends = o + a[there, None] * d, o + b[there, None] * d
                if there.size:
                    own[there] += medium.segment(*ends, d).depth
            share = np.exp(-(depth + own_share * own))[:, None] * np.ones(3)
            if s > 0:
                middle = np.where(hits, np.clip(0.5 * (begin + end), whole.enter[:, 0], whole.leave[:, 0]), 0.0)
                spread = self._spread(spread, origin, direction, middle, 1.0 / speed, hits, shadow.cone_degrees)
                share = (1.0 - s) * share + s * spread * np.exp(-own_share * less * own[:, None])
                spread = spread * np.exp(-less * own[:, None])
            depth += own
            self.light[k] = share

    def _spread(self, spread, origin, direction, middle, gap, hits, degrees):
        """The mean [n, 3] of what a cone brings from the slab before."""
        forward, right, up = self.camera.basis()
        if self.camera.projection == "orthographic":
            texel = np.full(len(origin), self.camera.height / self.height)
        else:
            tangent = 2.0 * np.tan(np.radians(self.camera.fov_degrees) / 2.0) / self.height
            texel = tangent * np.maximum(middle, 1e-9) * (direction @ forward)
        reach = np.where(hits, gap / texel, 0.0)
        row, column = np.divmod(np.arange(len(origin)), self.width)
        mean = np.zeros_like(spread)
        for x, y, z in cone_directions(degrees):
            mean += self._between(spread, column + reach * x / z, row + reach * y / z) / CONE_DIRECTIONS
        return mean

    def _between(self, of_texels, x, y):
        """[n, 3] between texels of one slab [texels, 3], or of a slab of its own for each place [n, texels, 3]."""
        x, y = np.clip(x, 0, self.width - 1), np.clip(y, 0, self.height - 1)
        ix, iy = np.minimum(x.astype(int), self.width - 2), np.minimum(y.astype(int), self.height - 2)
        fx, fy = (x - ix)[:, None], (y - iy)[:, None]
        at = iy * self.width + ix
        a, b, c, d = (of_texels[at + o] for o in (0, 1, self.width, self.width + 1))
        return (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d)

    def texel_places(self, at):
        """(column, row) of the texels' rays through places [n, 3]."""
        forward, right, up = self.camera.basis()
        away = at - np.asarray(self.camera.position)
        across, above = away @ right, away @ up
        if self.camera.projection == "orthographic":
            texel = self.camera.height / self.height
        else:
            tangent = 2.0 * np.tan(np.radians(self.camera.fov_degrees) / 2.0) / self.height
            texel = tangent * (away @ forward)
        return across / texel + 0.5 * (self.width - 1), -above / texel + 0.5 * (self.height - 1)

    def transmittance(self, number, at, to_light, distance, weight, surface, gradient):
        slab = np.clip(np.floor(self.slabs.number(at)).astype(int), 0, self.slabs.count - 1)
        texels = self.width * self.height
        x, y = self.texel_places(at)
        x, y = np.clip(x, 0, self.width - 1), np.clip(y, 0, self.height - 1)
        ix, iy = np.minimum(x.astype(int), self.width - 2), np.minimum(y.astype(int), self.height - 2)
        fx, fy = (x - ix)[:, None], (y - iy)[:, None]
        corner = slab * texels + iy * self.width + ix
        flat = self.light.reshape(-1, 3)
        a, b, c, d = (flat[corner + o] for o in (0, 1, self.width, self.width + 1))
        return (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d)


def render_half_angle_twin(resolved) -> np.ndarray:
    """The picture of ``resolved``, premultiplied linear RGBA, float64 [height, width, 4]."""
    medium, slabs = Medium(resolved), Slabs(resolved)
    light = SlabLight(resolved, medium, slabs) if slabs.light is not None and resolved.shadow is not None else None
    shader = Shader(resolved, None, light)
    origin, direction = resolved.camera.world_rays(resolved.image.width, resolved.image.height)
    shape = origin.shape[:-1]
    origin, direction = origin.reshape(-1, 3), direction.reshape(-1, 3)
    kept = kept_stretches(medium.grid, resolved.clips, origin, direction)
    rgba = np.zeros((len(origin), 4))
    edge = medium.grid.smallest_edge
    for slot in range(kept.enter.shape[1]):
        enter, leave, normals = kept.enter[:, slot], kept.leave[:, slot], kept.normal[:, slot]
        rays = np.nonzero(np.isfinite(enter))[0]
        at = slabs.pieces(origin[rays], direction[rays], enter[rays], leave[rays])
        at = np.concatenate([enter[rays, None], at, leave[rays, None]], axis=1)
        for a, b in zip(at.T[:-1], at.T[1:]):
            here = (a < b) & (rgba[rays, 3] < 1.0 - resolved.integration.early_termination)
            n, a, b = rays[here], a[here], b[here]
            if not n.size:
                continue
            o, d = origin[n], direction[n]
            piece = medium.segment(o + a[:, None] * d, o + b[:, None] * d, d)
            share = np.clip(1.0 - (0.5 * (a + b) - enter[n]) / edge, 0.0, 1.0)
            share = np.where(np.any(normals[n] != 0, axis=1), share, 0.0)
            color, seen = piece.color.copy(), piece.depth > 0
            color[seen] = shader.lit(
                color[seen], piece.middle[seen], piece.gradient[seen], d[seen],
                weight=np.ones(seen.sum()), cut_normal=normals[n[seen]], cut_share=share[seen],
            )  # fmt: skip
            opacity = (1.0 - rgba[n, 3]) * -np.expm1(-piece.depth)
            rgba[n] += opacity[:, None] * np.column_stack([color, np.ones(n.size)])
    return rgba.reshape(*shape, 4)


def _casts(light) -> bool:
    return light.casts_shadow and light.type != "headlight"
