"""Tunables: the keys of a scene that trade accuracy for time, and which values of each are tried.

``clvol tradeoff`` and the searches for an error or a time use the keys in ``TUNABLES``. To add a tunable, add a line
there. Every other key of these tables must be in ``NOT_TUNABLE``, with the reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from clvol.integrators.multiresolution.residency import block_source
from clvol.integrators.multiresolution.sample_allocator import overhead_bytes, sample_dtype
from clvol.integrators.pyramid.oracles import names, oracle_named
from clvol.integrators.raycast.step_map import is_smooth
from clvol.scene.compression import Compression
from clvol.scene.image import ImageSettings
from clvol.scene.integration import Integration
from clvol.scene.multiresolution import Multiresolution
from clvol.scene.pyramid import Pyramid
from clvol.scene.resolve import ResolvedScene
from clvol.scene.sizes import parse_size
from clvol.scene.table import Table

TABLES: dict[str, type[Table]] = {
    table.table_name(): table for table in (Integration, ImageSettings, Compression, Multiresolution, Pyramid)
}
_STEPS = tuple(2.0 ** (k / 2) for k in range(6, -11, -1))  # 8 ... 1/32
_SHARES = 5  # number of halvings of the volume's size that are tried as budgets
_UNITS = ("B", "KiB", "MiB", "GiB", "TiB")


def _always(*_: Any) -> bool:
    return True


def _itself(value: Any) -> Any:
    return value


@dataclass(frozen=True, eq=False)
class Tunable:
    """A key of a scene that trades accuracy for time. ``title`` and ``unit`` name it in reports.

    ``values``: the values to try, or a function of a resolved scene that returns them. If ``is_ladder``, they are
    ordered from cheap to accurate; otherwise they are alternatives in any order.

    ``methods``: the values of integration.method to which it belongs; if empty, all.
    ``applies(scene)``: whether it has an effect in combination with the scene's other keys.
    ``is_main``: accuracy is first gained with this ladder, on which each notch has about the same effect.
    ``is_continuous``: values between those of the ladder are valid, too.
    ``of_picture``: pixels depend on their neighbours, so single pixels do not show the effect.
    ``of_area``: tried only where the truth is the integral over each pixel; on a ray through its middle it has no
    influence.
    ``alone``: its alternatives are tried by themselves, not in all combinations with those of other tunables.
    ``saves_memory``: cheap values are useful even if they save no time. Where its values are alternatives, the scene's
    own is kept as long as it reaches the requested error.
    ``order``: maps the values of a ladder to numbers that ascend or descend along it.
    """

    title: str
    unit: str
    values: tuple | Callable[[Any], tuple]
    is_ladder: bool = True
    is_main: bool = False
    is_continuous: bool = False
    of_picture: bool = False
    alone: bool = False
    of_area: bool = False
    saves_memory: bool = False
    methods: tuple[str, ...] = ()
    applies: Callable[[Any], bool] = _always
    order: Callable[[Any], Any] = _itself

    def is_of(self, method: str) -> bool:
        """Whether it belongs to ``method``, a value of integration.method."""
        return not self.methods or method in self.methods

    def counts(self, scene: Any) -> bool:
        """Whether it has an effect in combination with the scene's method and other keys."""
        return self.is_of(scene.integration.method) and self.applies(scene)

    def values_for(self, resolved: ResolvedScene) -> tuple:
        return self.values(resolved) if callable(self.values) else self.values


def _precisions(resolved: ResolvedScene) -> tuple[str, ...]:
    """Voxel types smaller than that of the volume, and the volume as stored."""
    volume = resolved.volume
    smaller = [k for k, size in (("uint8", 1), ("uint16", 2)) if size < volume.dtype.itemsize]
    if volume.nan_count or volume.inf_count:  # integers cannot represent them
        smaller = []
    return (*smaller, "stored")


def _budgets(resolved: ResolvedScene) -> tuple[str, ...]:
    """Memory sizes with room for shares of the volume, up to all of it, and for everything else that is needed."""
    blocks = block_source(resolved.volume).blocks
    whole = blocks.count * blocks.edge**3 * sample_dtype(resolved.volume.dtype).itemsize
    sizes = []
    for halvings in range(_SHARES, -1, -1):
        share = size = whole >> halvings
        for _ in range(2):  # the map of empty space is finer if the size allows, so its own size depends on the result
            size = share + overhead_bytes(blocks, size)
        sizes.append(_readable(size))
    return tuple(dict.fromkeys(sizes))


def _readable(size: float) -> str:
    """``size`` bytes rounded up to two digits, with a unit."""
    unit = min(max(int(math.log(size, 1024)), 0), len(_UNITS) - 1)
    value = size / 1024**unit
    digit = 10 ** max(math.floor(math.log10(value)) - 1, -1)
    return f"{math.ceil(value / digit) * digit:.4g} {_UNITS[unit]}"


def _tile_shares(resolved: ResolvedScene) -> tuple[float, ...]:
    return tuple(s for s in (0.3, 0.5, 0.7, 0.9, 1.0) if s >= resolved.multiresolution.tile_low)


def _codecs(resolved: ResolvedScene) -> tuple[str, ...]:
    """Voxels as they are, too, where the scene has them encoded with an error."""
    codec = resolved.compression.codec
    return (codec, "none") if _is_compressed(resolved) else (codec,)


def _targets(key: str, values: tuple[float, ...]) -> Callable[[Any], tuple]:
    """The values of a target, where it is the one that the scene states; otherwise nothing to choose from."""

    def values_for(resolved: ResolvedScene) -> tuple:
        return values if _is_compressed(resolved) and key in resolved.compression.stated else ()

    return values_for


def _is_compressed(scene: Any) -> bool:
    return scene.compression.is_lossy


def _oracles(resolved: ResolvedScene) -> tuple[str, ...]:
    return names()  # read at each call, because a caller may have registered an oracle


_RAYCAST, _BLOCKS, _PYRAMID = ("raycast",), ("multiresolution",), ("pyramid",)

TUNABLES: dict[str, Tunable] = {
    "integration.method": Tunable("method", "", ("raycast", "multiresolution", "pyramid"), is_ladder=False),
    "integration.step": Tunable(
        "step", "voxel edges", _STEPS, is_main=True, is_continuous=True,
        methods=("raycast", "multiresolution", "pyramid"),
    ),
    "integration.classification": Tunable(
        "classification", "", ("pre", "post", "preintegrated"), is_ladder=False,
    ),
    "integration.quadrature": Tunable("quadrature", "", ("steps", "cells"), is_ladder=False),
    "integration.filter": Tunable("filter", "", ("nearest", "linear", "cubic"), is_ladder=False),
    "integration.early_termination": Tunable(
        "early termination", "transmittance", (0.1, 0.03, 0.01, 1e-3, 1e-4, 0.0),
    ),
    "integration.voxel_precision": Tunable("voxel precision", "", _precisions, methods=_RAYCAST),
    "image.ray_spacing": Tunable("ray spacing", "pixels", (8, 4, 2, 1), of_picture=True, methods=_RAYCAST),
    "image.ray_tolerance": Tunable(
        "ray tolerance", "linear light", (0.3, 0.1, 0.03, 0.01, 0.003), of_picture=True,
        methods=_RAYCAST, applies=lambda scene: scene.image.ray_spacing > 1,
    ),
    "image.samples": Tunable("rays per pixel", "", (1, 2, 4, 8, 16), of_picture=True, of_area=True),
    "image.edge_threshold": Tunable(
        "edge threshold", "of what is displayed", (0.3, 0.1, 0.03, 0.01, 0.003, 0.0), of_picture=True, of_area=True,
        applies=lambda scene: scene.image.refines,
    ),
    "compression.codec": Tunable("codec", "", _codecs, is_ladder=False, alone=True, saves_memory=True),
    "compression.max_voxel_error": Tunable(
        "largest voxel error", "of the range", _targets("max_voxel_error", (0.08, 0.04, 0.02, 0.01, 0.005, 0.0025)),
        saves_memory=True, applies=_is_compressed,
    ),
    "compression.psnr": Tunable(
        "PSNR of voxels", "dB", _targets("psnr", (34.0, 38.0, 42.0, 46.0, 50.0, 54.0)), saves_memory=True,
        applies=_is_compressed,
    ),
    "compression.bits_per_voxel": Tunable(
        "bits per voxel", "", _targets("bits_per_voxel", (0.25, 0.5, 1.0, 2.0, 4.0)), saves_memory=True,
        applies=_is_compressed,
    ),
    "integration.step_error": Tunable(
        "step error", "linear light per voxel edge", (1e-2, 3e-3, 1e-3, 1e-4, 0.0), methods=_RAYCAST,
        applies=is_smooth,
    ),
    "multiresolution.memory": Tunable(
        "memory", "", _budgets, saves_memory=True, methods=_BLOCKS, order=parse_size,
    ),
    "multiresolution.stepping": Tunable(
        "stepping", "", ("naive", "limited", "bounded", "full"), is_ladder=False, alone=True, methods=_BLOCKS,
    ),
    "multiresolution.step_error": Tunable(
        "step error", "linear light", (0.3, 0.1, 0.03, 0.01, 0.003, 0.001), methods=_BLOCKS,
        applies=lambda scene: scene.multiresolution.stepping == "bounded",
    ),
    "multiresolution.interblock": Tunable(
        "interblock", "", (False, True), is_ladder=False, alone=True, methods=_BLOCKS,
    ),
    "multiresolution.tiles": Tunable("tiles", "pixels", (32, 16, 8, 0), of_picture=True, methods=_BLOCKS),
    "multiresolution.tile_high": Tunable(
        "highest share of rays", "of a tile's edge", _tile_shares, of_picture=True, methods=_BLOCKS,
        applies=lambda scene: scene.multiresolution.tiles > 0,
    ),
    "pyramid.levels": Tunable("levels", "", (5, 4, 3, 2, 1, 0), methods=_PYRAMID),
    "pyramid.oracle": Tunable("oracle", "", _oracles, is_ladder=False, alone=True, methods=_PYRAMID),
    "pyramid.epsilon": Tunable(
        "epsilon", "", (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4), methods=_PYRAMID,
        applies=lambda scene: oracle_named(scene.pyramid.oracle).takes_epsilon,
    ),
}  # fmt: skip

NOT_TUNABLE: dict[str, str] = {
    "integration.prefilter": "another picture: the field then passes through the voxels",
    "integration.filter_table": "another picture: the kernel of the filter 'table'",
    "integration.filter_reach": "another picture: how far that kernel reaches",
    "integration.minification": "another picture: what a pixel covers is averaged before it is classified",
    "integration.level_bias": "another picture: how much of it is averaged",
    "integration.compositing": "another picture: how the values along a ray become a pixel",
    "integration.blend": "another picture: how those of channels are put together",
    "integration.attenuation": "another picture: how much samples behind others contribute",
    "integration.segments": "an approximation for comparison, whose error smaller steps make up for at once",
    "integration.table_size": "of the approximation that is for comparison",
    "integration.tolerance": "belongs to the method 'reference', against which errors are measured",
    "image.background": "another picture: what is behind the volume",
    "image.sample_pattern": "where rays go, not how many",
    "image.refine": "that of edge_threshold 0 is 'all'",
    "image.pixel_filter": "another picture: how a pixel weighs what it shows",
    "image.width": "another picture",
    "image.height": "another picture",
    "compression.weighting": "which errors matter for the transfer function; it costs nothing",
    "compression.decode": "the same picture",
    "compression.memory": "the same picture",
    "compression.seed": "another picture, not a better one",
    "multiresolution.view_weighting": "which errors matter for the view; it costs nothing",
    "multiresolution.occlusion": "which errors matter for the view; it costs nothing",
    "multiresolution.tile_priority": "where rays go, not how many",
    "multiresolution.tile_low": "the lower end of the range whose upper end, tile_high, is tried",
}
