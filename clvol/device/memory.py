"""How a volume is laid out on a device, and what it takes there: arithmetic, without a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clvol.volume import Volume
from clvol.volume.voxel_layout import device_bytes, holds_pairs

if TYPE_CHECKING:
    from clvol.scene import Scene
    from clvol.scene.resolve import ResolvedScene

# Magnitudes that float32 arithmetic takes as they are, squares of their gradients too.
_PLAIN_RANGE = (1e-12, 1e18)


@dataclass(frozen=True)
class ValueMap:
    """Kernels compute with (voxel - bias) * gain, which is the voxel itself unless it is float64
    or float32 of extreme magnitude."""

    bias: float = 0.0
    gain: float = 1.0

    def __call__(self, values):
        return (np.asarray(values, np.float64) - self.bias) * self.gain


@dataclass(frozen=True)
class Perturbation:
    """What noise does at most: ``added`` to or taken from a value that kernels compute with, and how many
    cells (x, y, z) a place is moved by."""

    added: float = 0.0
    cells: tuple[int, int, int] = (0, 0, 0)


UNPERTURBED = Perturbation()


def value_map(volume: Volume) -> ValueMap:
    low, high = volume.value_range
    if volume.dtype == np.float64:
        # Halves first: high - low may overflow where high / 2 - low / 2 does not.
        half = high / 2 - low / 2
        if not half > 0:
            return ValueMap(low, 1.0)
        return ValueMap(low, float(min(0.5 / half, 1e300)))
    largest = max(abs(low), abs(high))
    if volume.dtype == np.float32 and largest and not _PLAIN_RANGE[0] < largest < _PLAIN_RANGE[1]:
        exponent = int(np.clip(-np.floor(np.log2(largest)), -126, 127))
        return ValueMap(0.0, 2.0**exponent)
    return ValueMap()


def voxel_switches(volume: Volume, values: ValueMap) -> dict[str, int]:
    dtype = volume.dtype
    return {
        "VOXEL_BITS": dtype.itemsize * 8,
        "VOXEL_SIGNED": int(dtype.kind == "i"),
        "VOXEL_SCALED": int(dtype == np.float32 and values.gain != 1.0),
        "VOXEL_PAIRS": int(holds_pairs(volume)),
        "VOXEL_HOLES": int(volume.nan_count + volume.inf_count > 0),
    }


def scene_bytes(volume: Volume, width: int, height: int) -> int:
    """Bytes on the device for everything that a picture needs: volume, picture and depth."""
    return device_bytes(volume) + width * height * 20


def method_bytes(volume: Volume, scene: Scene | ResolvedScene) -> int:
    """As ``scene_bytes``, by the method that ``scene`` asks for."""
    from clvol.integrators.multiresolution.sample_allocator import map_shift, most_bytes
    from clvol.store.geometry import BlockGrid

    size = scene.image.width, scene.image.height
    if scene.integration.method == "pyramid":
        from clvol.integrators.pyramid.layout import pyramid_bytes

        return scene_bytes(volume, *size) + pyramid_bytes(volume, scene)
    if scene.integration.method != "multiresolution":
        return scene_bytes(volume, *size)
    source = getattr(volume, "blocks_source", None)
    blocks = BlockGrid(volume.shape) if source is None else source.blocks
    needed = most_bytes(blocks, volume.dtype, scene.multiresolution.memory_bytes)
    if scene.multiresolution.stepping == "pyramid":
        from clvol.integrators.pyramid.layout import block_pyramid_bytes

        edge = blocks.edge >> map_shift(blocks, scene.multiresolution.memory_bytes)
        needed += block_pyramid_bytes(tuple(n * edge for n in blocks.counts), scene)
    return needed + size[0] * size[1] * 20
