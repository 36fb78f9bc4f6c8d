"""A volume divided into boxes by planes between voxels: a kd-tree (Bentley 1975), whose boxes any camera sees in an
order (Fuchs, Kedem and Naylor 1980)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

Lattice = tuple[int, int, int]  # x, y, z


@dataclass(frozen=True)
class Box:
    """Lattice units from ``lower`` to ``upper`` (x, y, z); the planes between boxes belong to the upper one."""

    lower: Lattice
    upper: Lattice

    @property
    def extent(self) -> Lattice:
        x, y, z = (b - a for a, b in zip(self.lower, self.upper))
        return x, y, z


@dataclass(frozen=True)
class Tree:
    """``box``, cut at ``at`` along ``axis`` (0: x) into two trees; a leaf with the ``number`` of its box is not cut."""

    box: Box
    number: int | None = None
    axis: int = 0
    at: int = 0
    parts: tuple[Tree, ...] = ()

    @property
    def boxes(self) -> list[Box]:
        """Of all leaves, by number."""
        if self.number is not None:
            return [self.box]
        return [box for part in self.parts for box in part.boxes]

    def front_to_back(self, eye: Sequence[float] | None, forward: Sequence[float]) -> Iterator[int]:
        """The numbers of the leaves, nearer ones first: of two boxes, no ray enters the second and then the first.
        ``eye`` (x, y, z) in lattice units; None: rays are parallel to ``forward``."""
        if self.number is not None:
            yield self.number
            return
        below = forward[self.axis] >= 0 if eye is None else eye[self.axis] < self.at
        for part in self.parts if below else self.parts[::-1]:
            yield from part.front_to_back(eye, forward)


def divided(size: Lattice, count: int) -> Tree:
    """A volume of ``size`` lattice points in ``count`` boxes of about the same size, as near to cubes as possible.
    ValueError if it has fewer lattice units."""
    return _divided(Box((0, 0, 0), (size[0] - 1, size[1] - 1, size[2] - 1)), count, 0)


def most_boxes(size: Lattice) -> int:
    """In how many boxes ``divided`` may cut: of two lattice units at least along each axis that is cut."""
    return int(np.prod([max((n - 1) // 2, 1) for n in size], dtype=np.int64))


def _divided(box: Box, count: int, first: int) -> Tree:
    if count == 1:
        return Tree(box, number=first)
    axis = int(np.argmax(box.extent))
    length, lower = box.extent[axis], box.lower[axis]
    few = count // 2
    at = lower + min(max(round(length * few / count), 1), length - 1)
    if length < 2:
        raise ValueError(f"{count} boxes of {box.extent} lattice units")
    ends, begins = list(box.upper), list(box.lower)
    ends[axis] = begins[axis] = at
    low = _divided(Box(box.lower, (ends[0], ends[1], ends[2])), few, first)
    high = _divided(Box((begins[0], begins[1], begins[2]), box.upper), count - few, first + few)
    return Tree(box, None, axis, at, (low, high))
