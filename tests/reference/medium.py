"""The translucent volume: what every segment of a ray, or of a shadow ray, is made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.device.noise import noise_tile
from clvol.device.voxel_colors import linear_light
from reference import classify
from reference.field import Field, GridSampler
from reference.integral_table import IntegralTable
from reference.noise import fractal_noise

LONGEST_HAIR = 32.0  # voxel edges from a sample to its root


@dataclass
class Segment:
    """Of n segments: ``color`` [n, 3] (linear), optical ``depth`` [n], ``middle`` (world) [n, 3]
    and the ``gradient`` there [n, 3] (value per world length, world axes)."""

    color: np.ndarray
    depth: np.ndarray
    middle: np.ndarray
    gradient: np.ndarray
    place: np.ndarray | float = 0.5  # where between their ends what is seen lies on average [n]
    light: np.ndarray | float = 0.0  # of associated colours, emitted by the segment [n, 3]


class Medium:
    """The volume of a resolved scene with its transfer functions, factors, fields and noise.

    ``tile``: uint8 [z, y, x, 4] for all terms; without it, their seeds decide. ``field``: in place of the volume's own
    reconstruction (``BlockMediumField``).
    """

    def __init__(self, resolved, tile: np.ndarray | None = None, field=None) -> None:
        integration, volume = resolved.integration, resolved.volume
        self.grid = volume.grid
        self.value_range = volume.value_range
        self.field = field or Field(
            volume,
            integration.filter,
            resolved.gradient.operator,
            getattr(integration, "prefilter", False),
        )
        self.classification = integration.classification
        if integration.filter == "nearest" and self.classification == "preintegrated":
            self.classification = "post"  # values jump: a chord between them is not there
        self.noise = tuple(term for term in resolved.noise if term.amplitude != 0)
        self.fur = resolved.fur
        self.tile = tile
        animation = resolved.animation
        self.time = animation.time
        shift = animation.cycle * self.time if animation.cycle else None
        layers = [(0.0, resolved.transfer_function)]
        layers += [(layer.magnitude, layer.function) for layer in resolved.transfer_layers]
        self.joint = [] if not layers[1:] else self._grid_of_layers(resolved)
        self.layers_at = np.array([magnitude for magnitude, _ in layers])
        self.functions = [
            classify.MovedFunction(function, self.value_range, shift) for _, function in layers
        ]
        self.gradient_opacity = resolved.gradient_opacity
        self.directional_opacity = resolved.directional_opacity
        self.glow = resolved.glow
        self.lit_at_ends = resolved.material.light_at == "ends" and self.classification == "preintegrated"
        self.integrals = None
        if integration.segments == "integral-table":
            self.integrals = IntegralTable(resolved)
        self.fields = [(field, _sampler(field)) for field in resolved.fields]

    @staticmethod
    def _grid_of_layers(resolved) -> list:
        """(sampler, base, values ascending) of each field of a joint function."""
        fields = [field for field in resolved.fields if field.role == "value"]
        points = [layer.values for layer in resolved.transfer_layers]
        return [
            (_sampler(field), field.base, np.unique([field.base, *(point[k] for point in points)]))
            for k, field in enumerate(fields)
        ]

    def _joint_weights(self, world: np.ndarray) -> np.ndarray:
        """Weights [n, layers] of the functions of a joint function: products of hats over each field's values."""
        weights = np.ones((len(world), 1))
        for sampler, base, at in self.joint:
            value = np.where(sampler.inside(world), sampler(world), np.nan)
            along = classify.layer_weights(np.where(np.isfinite(value), value, base), at)
            weights = (along[:, None, :] * weights[:, :, None]).swapaxes(1, 2).reshape(len(world), -1)
        return weights

    def value(self, world: np.ndarray) -> np.ndarray:
        """The field's value [n] at [n, 3], noise included; NaN where there is none."""
        moved, added = self._perturbed(world)
        return self.field.value(moved) + added

    def gradient(self, world: np.ndarray) -> np.ndarray:
        """The gradient [n, 3] of the field. With noise: differences of ``value`` over a smallest voxel
        edge along the index axes, one-sided at the volume's faces."""
        if not self.noise:
            return self.field.gradient(world)
        lower, upper = self.grid.index_bounds()
        to_index, to_world = self.grid.world_to_index(), self.grid.index_to_world()
        index = world @ to_index[:3, :3].T + to_index[:3, 3]
        slopes = []
        for axis in range(3):
            reach = 0.5 * self.grid.smallest_edge / self.grid.spacing[axis]
            ends = [index.copy(), index.copy()]
            for end, sign in zip(ends, (-1, 1)):
                at = index[:, axis] + sign * reach
                end[:, axis] = np.clip(at, lower[axis], upper[axis])
            first, last = (self.value(end @ to_world[:3, :3].T + to_world[:3, 3]) for end in ends)
            length = ends[1][:, axis] - ends[0][:, axis]
            slopes.append((last - first) / np.where(length > 0, length, 1.0))
        return np.stack(slopes, axis=-1) @ to_index[:3, :3]

    def _perturbed(self, world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the volume is sampled [n, 3] (beyond its faces that is on them), and what is added."""
        moved, added = world.copy(), np.zeros(len(world))
        for term in self.noise:
            tile = noise_tile(term.seed) if self.tile is None else self.tile
            sums = fractal_noise(term, tile, self.grid, world, self.time)
            if term.target == "value":
                added += term.amplitude * sums[:, 3]
            else:
                moved += term.amplitude * sums[:, :3] @ self.grid.direction.T
        return moved, added

    def segment(
        self,
        start: np.ndarray,
        end: np.ndarray,
        direction: np.ndarray,
        *,
        before: np.ndarray | None = None,
        curved: np.ndarray | None = None,
        steps: np.ndarray | None = None,
    ) -> Segment:
        """The segments from ``start`` to ``end`` [n, 3] on rays of unit ``direction`` [n, 3].

        Pre-integrated chords are ``curved`` [n] where the ray has a sample at ``before`` [n, 3],
        one step before the start; ``steps`` [n] is then the segments' length in steps.
        """
        middle = 0.5 * (start + end)
        length = np.linalg.norm(end - start, axis=1)
        parts = self._classified(start, end, length, before, curved, steps)
        gradient = self.gradient(middle)
        slope = _finite_norm(gradient)
        if len(parts) == 1:
            color, depth = parts[0]
        else:
            weights = self._joint_weights(middle) if self.joint else classify.layer_weights(slope, self.layers_at)
            parts = [(c, d * w) for (c, d), w in zip(parts, weights.T)]
            color, depth = classify.combined(parts)
        if self.gradient_opacity is not None:
            depth = depth * _factor(self.gradient_opacity, slope)
        if self.directional_opacity is not None:
            along = np.abs(np.sum(gradient * direction, axis=1))
            along = np.where(np.isfinite(along), along, 0.0)
            depth = depth * _factor(self.directional_opacity, along)
        for hairs in self.fur:
            depth = depth * self._fur_factor(hairs, start, middle, end, gradient, before, curved, steps)
        color, depth = self._with_fields(color, depth, start, middle, end, length)
        light: np.ndarray | float = 0.0
        if self.glow is not None:
            light = self._light(start, middle, end, length, before, curved, steps)
            light = light * self.kept_share(start, end)[:, None]
        place: np.ndarray | float = 0.5
        if self.lit_at_ends:
            front, back = self._chord(start, end, before, curved, steps)
            place = classify.placed_chord(self.functions[0], front, back, length)[2]
        return Segment(color, depth, middle, gradient, place, light)

    def _fur_factor(self, hairs, start, middle, end, gradient, before, curved, steps) -> np.ndarray:
        """The share [n] of the extinction that hairs have in segments: all of it up to the root's value."""
        value = self.value(middle)
        if self.classification == "preintegrated":
            value = np.mean(self._chord(start, end, before, curved, steps), axis=0)
        away = np.where(np.isfinite(value), hairs.root - value, 0.0)
        height = np.maximum(away / (hairs.root - hairs.tip), 0.0)
        slope = _finite_norm(gradient)
        has = (slope > 0)[:, None]
        way = np.where(has, gradient, 0.0) / np.where(has, slope[:, None], 1.0)
        longest = LONGEST_HAIR * self.grid.smallest_edge
        reach = np.clip(away / np.where(slope > 0, slope, 1.0), -longest, longest)
        tile = noise_tile(hairs.seed) if self.tile is None else self.tile
        noise = fractal_noise(hairs, tile, self.grid, middle + way * reach[:, None], self.time)[:, 3]
        return np.clip(1.0 - hairs.amplitude * (height - 0.5 * (1.0 + np.clip(noise, -1.0, 1.0))), 0.0, 1.0)

    def _light(self, start, middle, end, length, before, curved, steps) -> np.ndarray:
        """What associated colours emit along the chord of each segment [n, 3]: differences of their integral."""
        if self.classification == "preintegrated":
            front, back = self._chord(start, end, before, curved, steps)
        else:
            front = back = self.value(middle)
        known = np.isfinite(front) & np.isfinite(back)
        front, back = (np.where(known, each, self.glow.values[0]) for each in (front, back))
        low, high = np.minimum(front, back), np.maximum(front, back)
        even = high - low < 1e-9 * max(np.ptp(self.glow.values), 1.0)
        mean = (self._emitted_up_to(high) - self._emitted_up_to(low)) / np.where(even, 1.0, high - low)[:, None]
        mean = np.where(even[:, None], self._emitted(0.5 * (low + high)), mean)
        return np.where(known[:, None], mean, 0.0) * length[:, None]

    def _emitted(self, value: np.ndarray) -> np.ndarray:
        """Light [n, 3] at values [n]; of two points at one value the later one holds there."""
        at = np.searchsorted(self.glow.values, value, side="right")
        low, high = np.clip(at - 1, 0, None), np.clip(at, None, len(self.glow.values) - 1)
        span = self.glow.values[high] - self.glow.values[low]
        share = np.clip((value - self.glow.values[low]) / np.where(span > 0, span, 1.0), 0.0, 1.0)[:, None]
        return self.glow.light[low] + share * (self.glow.light[high] - self.glow.light[low])

    def _emitted_up_to(self, value: np.ndarray) -> np.ndarray:
        """The integral [n, 3] of the light from the first point to values [n]."""
        values, light = self.glow.values, self.glow.light
        pieces = 0.5 * np.diff(values)[:, None] * (light[1:] + light[:-1])
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(pieces, axis=0)])
        last = np.clip(np.searchsorted(values, value, side="right") - 1, 0, None)
        return sums[last] + 0.5 * (value - values[last])[:, None] * (light[last] + self._emitted(value))

    def is_kept(self, world: np.ndarray) -> np.ndarray:
        """Whether all masks keep these places [n, 3]: bool [n]."""
        return self.kept_share(world, world) > 0

    def kept_share(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """The share [n] of each segment that the masks keep."""
        share = np.ones(len(start))
        for field, sampler in self.fields:
            if field.role == "mask":
                share = share * _kept_by_mask(field, sampler, start, end)
        return share

    def _classified(self, start, end, length, before, curved, steps):
        """(colour, optical depth) of the segments by each layer's function."""
        middle = 0.5 * (start + end)
        if self.classification == "pre":
            moved, added = self._perturbed(middle)
            voxels, weights = self.field.value.taps(moved)
            voxels = voxels + np.broadcast_to(added, len(middle))[:, None]
            return [classify.of_voxels(f, voxels, weights, length) for f in self.functions]
        if self.classification == "post":
            value = self.value(middle)
            return [classify.of_value(f, value, length) for f in self.functions]
        front, back = self._chord(start, end, before, curved, steps)
        if self.integrals is not None:
            return [self.integrals.of_chord(front, back, length)]
        return [classify.of_chord(f, front, back, length) for f in self.functions]

    def _chord(self, start, end, before, curved, steps) -> tuple[np.ndarray, np.ndarray]:
        """The values between which a segment is integrated."""
        front, back = self.value(start), self.value(end)
        if curved is not None and curved.any():
            shifted = classify.curvature_shift(
                self.value(before), front, back, steps, self.field.filter
            )
            front, back = (np.where(curved, s, v) for s, v in zip(shifted, (front, back)))
        return front, back

    def _with_fields(self, color, depth, start, middle, end, length):
        for field, sampler in self.fields:
            if field.role == "color":
                parts = field.colors_of_voxels
                light = np.stack([linear_light(each) for each in (parts.red, parts.green, parts.blue)], axis=-1)
                mixed = GridSampler(light, field.volume.grid)(middle)
                color = np.where(sampler.inside(middle)[:, None], mixed, color)
        for field, sampler in self.fields:
            if field.role == "label":
                label, inside = sampler(middle), sampler.inside(middle)
                for k, number in enumerate(field.labels):
                    is_it = inside & (label == number)
                    color = np.where(is_it[:, None], field.colors[k], color)
                    depth = np.where(is_it, depth * field.factors[k], depth)
        for field, sampler in self.fields:
            if field.role == "density":
                value = np.where(sampler.inside(middle), sampler(middle), np.nan)
                function = classify.MovedFunction(field.function)
                added = classify.of_value(function, value, length)
                color, depth = classify.combined([(color, depth), added])
        return color, depth * self.kept_share(start, end)


def _sampler(field) -> GridSampler:
    filter = "nearest" if field.role == "label" else "linear"
    return GridSampler(field.volume.data, field.volume.grid, filter)


def _kept_by_mask(field, sampler, start, end):
    """The share [n] kept: the mask runs linearly from end to end. Of a segment with an end outside
    the mask's grid, or where it is not finite, nothing is kept."""
    ends, known = [], np.ones(len(start), bool)
    for at in (start, end):
        above = sampler(at) - field.threshold
        ends.append(above if field.keep == "above" else -above)
        known &= sampler.inside(at) & np.isfinite(above)
    first, last = (np.where(known, signed, -1.0) for signed in ends)
    crosses = (first >= 0) != (last >= 0)
    at = first / np.where(crosses, first - last, 1.0)
    kept = np.where((first >= 0) & (last >= 0), 1.0, 0.0)
    return np.where(crosses, np.where(first >= 0, at, 1.0 - at), kept)


def _finite_norm(gradient: np.ndarray) -> np.ndarray:
    slope = np.linalg.norm(gradient, axis=1)
    return np.where(np.isfinite(slope), slope, 0.0)


def _factor(factor, x: np.ndarray) -> np.ndarray:
    """Linear between the points ``at``; of two at one place the later one holds."""
    at, factors = np.asarray(factor.at), np.asarray(factor.factors)
    high = np.clip(np.searchsorted(at, x, side="right"), 0, len(at))
    low, high = np.clip(high - 1, 0, len(at) - 1), np.clip(high, 0, len(at) - 1)
    span = at[high] - at[low]
    share = np.clip((x - at[low]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
    return factors[low] + share * (factors[high] - factors[low])
