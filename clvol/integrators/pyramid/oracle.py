"""Oracles of the method "pyramid", and their input."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clvol.errors import RenderError
from clvol.integrators.pyramid.cells import upload_distances
from clvol.transfer import TransferFunction
from clvol.transfer.lookup_nodes import LookupNodes

if TYPE_CHECKING:
    from clvol.device.volume import ResidentVolume
    from clvol.opencl.context import DeviceArray, DeviceContext

# Headers of cl/oracle.h. The last is a file that the caller supplies; no scene can supply one.
KERNEL_MINIMUM, KERNEL_MAP, KERNEL_ERROR, KERNEL_CUSTOM = "minimum", "map", "error", "custom"


@dataclass(frozen=True, eq=False)
class BlockCells:
    """The contents of the cells [z, y, x] of a volume of blocks: whether anything is ``shown`` (bool), the ``spacing``
    of the block's samples in voxels, and whether there are ``holes`` (bool): non-finite samples beside finite ones."""

    shown: np.ndarray
    spacing: np.ndarray
    holes: np.ndarray


@dataclass(frozen=True, eq=False)
class Asked:
    """The input of an oracle: a volume, a transfer function, and the map that it may fill in.

    ``volume``: on the device, with ``values`` that kernels compute with. ``function``: the transfer
    function over these, looked up between ``nodes`` (on the device: ``warp``). ``view``: numbers of the volume for
    kernels that read it, and the ``switches`` of these kernels. ``shape``: cells of the map (z, y, x).
    ``epsilon``: [pyramid] epsilon. ``opacity_edges``: opacity units in a smallest voxel edge. ``shift``: log2 of a map
    cell's edge in lattice units. ``edges`` (x, y, z): smallest voxel edges in a lattice unit, at least 1. ``reach``:
    larger distances, in smallest edges, are as good as this one. ``filter``: [integration] filter. ``blocks``: the cells of a
    volume of blocks, which has no array of voxels.
    """

    context: DeviceContext
    volume: ResidentVolume
    function: TransferFunction
    nodes: LookupNodes
    warp: DeviceArray
    view: np.ndarray
    switches: Mapping[str, int]
    epsilon: float
    opacity_edges: float
    shift: int
    edges: tuple[float, float, float]
    reach: float
    shape: tuple[int, int, int]
    filter: str = "linear"
    blocks: BlockCells | None = None

    @property
    def scales(self) -> np.ndarray:
        """Distances between samples that are considered: 1, 2, 4 ... edges, up to ``reach``."""
        return 2.0 ** np.arange(np.ceil(np.log2(max(self.reach, 1.0))) + 1)


class Oracle(ABC):
    """An estimate of how far apart samples may be. ``name``: as in [pyramid] oracle. ``kernel``: the header that
    evaluates it. ``folder``: for KERNEL_CUSTOM, the folder of "oracle_custom.h". ``takes_epsilon``: whether epsilon
    changes anything. ``leaps``: whether tiles may leap over space that is certainly empty, without the oracle."""

    name: str
    kernel: str = KERNEL_MAP
    folder: Path | None = None
    takes_epsilon: bool = True
    leaps: bool = True

    def numbers(self, asked: Asked) -> tuple[float, float, float, float]:
        """``pyramid->oracle`` of the kernel."""
        return (asked.epsilon, 0.0, 0.0, 0.0)

    def map(self, asked: Asked) -> DeviceArray | None:
        """uint8 on the device: ``in->map`` of the kernel; KERNEL_MAP and KERNEL_ERROR need distances in
        cells [z, y, x], as ``clvol.integrators.pyramid.cells.distance_map`` makes them."""
        return None


class MapOracle(Oracle):
    """An oracle that computes all distances beforehand."""

    @abstractmethod
    def distances(self, asked: Asked) -> np.ndarray:
        """float [z, y, x], ``asked.shape``: how far apart samples may be, in smallest voxel edges, anywhere in
        each cell. From one cell to another they should grow by at most the way between them (pyramid.h, freshness)."""

    def map(self, asked: Asked) -> DeviceArray:
        distances = np.asarray(self.distances(asked), np.float64)
        where = f"oracle {self.name!r}"
        if distances.shape != asked.shape:
            raise RenderError(where, f"gave distances {distances.shape}", f"{asked.shape}, as asked.shape")
        if not (distances >= 0).all():
            raise RenderError(where, "gave a distance that is negative or not a number", "0 or more")
        return upload_distances(asked.context, distances)
