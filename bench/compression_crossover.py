"""The pyramid beside the ray caster on codes that stay on the device, as samples become dearer. Kraus et al. (2007)
expect adaptive sampling to pay most where a sample is dear, as of compressed volumes, and do not measure it.

Samples of bricks of decoded voxels are hardly dearer than those of voxels. How they would be if every sample had to be
decoded is shown by samples with further look-ups, each of which waits for the one before (SAMPLE_REPEATS); a look-up
in codebooks for every corner costs a sample 6 to 11 times as much with two to four stages. Seconds are those of all
processors together, since other programs disturb them less.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

from bench.charts import _CLVOL, _GOAL, _VTK, _grid, _notes, _plain_log, _plt, _save
from bench.effects import ratio_of
from bench.multiresolution_scenes import BlockScene
from bench.pyramid_parts import crossing, crossing_text, dearer, picture, warm
from bench.pyramid_scenes import by_pyramid, by_rays
from bench.report import say
from clvol.accuracy.timing import take_turns

REPEATS, QUICK_REPEATS = (0, 1, 2, 4, 8), (0, 4)
_PER_CORNER = (6.0, 11.0)  # cost of a sample whose corners are decoded, two to four stages
_SLOW = 1.2  # seconds of processors from which three frames must do


def crossover(bench: Any, scene: BlockScene, repeats: tuple[int, ...]) -> dict[str, Any]:
    """``bench``: the ``Frames`` of compression_frames.py. "faster": how many times as fast the pyramid is."""
    made = _casters(bench, scene)
    frames = {way: picture(caster) for way, caster in made.items()}
    for method in ("raycast", "pyramid"):
        if (frames[f"voxels, {method}"].rgba != frames[f"resident, {method}"].rgba).any():
            raise RuntimeError(f"{scene.name}: the {method}'s picture of codes is not that of decoded voxels")
    dear = {(n, method): dearer(made[f"resident, {method}"], n)
            for n in repeats if n for method in ("raycast", "pyramid", "unskipped")}  # fmt: skip
    turns = {key: _timed(caster) for key, caster in {**made, **dear}.items()}
    times = take_turns(turns, bench.rounds, slow_seconds=_SLOW)
    cheapest = times["voxels, unskipped"]["median"]

    def row(name: str, n: int) -> dict[str, Any]:
        own = {way: times[(n, way) if n else f"{name}, {way}"] for way in ("raycast", "pyramid", "unskipped")}
        return {
            "held": name, "repeats": n, "cost": own["unskipped"]["median"] / cheapest,
            "faster": ratio_of(own["raycast"], own["pyramid"]), **own,
        }  # fmt: skip

    rows = [row("voxels", 0), *(row("resident", n) for n in repeats)]
    crossed = crossing([(found["cost"], found["faster"]["ratio"]) for found in rows[1:]])
    told = ", ".join(f"{r['faster']['ratio']:.2f} times as fast where a sample costs {r['cost']:.2f}" for r in rows)
    say(f"{scene.name}, the pyramid: {told}; faster {crossing_text(crossed)}")
    return {
        "scene": scene.name, "rows": rows, "crossing": vars(crossed),
        "times": {way: times[way] for way in made}, "samples": {way: frame.samples for way, frame in frames.items()},
        "faster": {found["held"]: found["faster"] for found in rows[:2]},
    }  # fmt: skip


def _casters(bench: Any, scene: BlockScene) -> dict[str, Any]:
    """Both methods on the decoded voxels and on the codes of the scene's store, compiled; and rays that leap over
    nothing, by which the cost of a sample is measured."""
    from dataclasses import replace

    from clvol.device.brick_pool import CodedBricks
    from clvol.device.volume import DeviceVolume
    from clvol.encoding.coded_volume import DecodedVolume, UndecodedVolume, decode_on_host, stored_codes
    from clvol.integrators.pyramid.bricks import BrickPyramidCaster
    from clvol.integrators.pyramid.caster import PyramidCaster
    from clvol.integrators.raycast.bricks import BrickCaster, BrickVolume
    from clvol.integrators.raycast.caster import Raycaster
    from clvol.opencl.context import DeviceContext
    from clvol.volume.voxel_layout import holds_pairs

    codes = stored_codes(bench.codes(scene))
    context = DeviceContext(bench.device)
    voxels = DecodedVolume(decode_on_host(codes.coded, codes.blocks, codes.codebooks), codes)
    rays, slices = by_rays(scene, voxels, bench.size), by_pyramid(scene, voxels, bench.size)
    whole = DeviceVolume(context, voxels)
    made: dict[str, Any] = {
        "voxels, raycast": Raycaster(context, rays, volume=whole),
        "voxels, unskipped": Raycaster(context, rays, volume=whole, skip=False),
        "voxels, pyramid": PyramidCaster(context, slices, volume=whole),
    }
    held = UndecodedVolume(codes)
    source = CodedBricks(context, held, codes.blocks, codes.codebooks, codes.coded)
    bricks = BrickVolume(context, source, None, pairs=holds_pairs(held))
    rays, slices = replace(rays, volume=held), replace(slices, volume=held)
    made |= {
        "resident, raycast": BrickCaster(context, rays, bricks),
        "resident, unskipped": BrickCaster(context, rays, bricks, skip=False),
        "resident, pyramid": BrickPyramidCaster(context, slices, bricks),
    }
    for caster in made.values():
        warm(caster)
    return made


def _timed(caster: Any) -> Callable[[], float]:
    def seconds() -> float:
        start = process_time()
        picture(caster)
        return process_time() - start

    return seconds


def crossover_chart(result: dict[str, Any], path: Path) -> Path:
    """How many times as fast the pyramid is over what a sample costs, a panel per scene."""
    plt = _plt()
    parts = result["crossover"]
    figure, axes = plt.subplots(1, len(parts), figsize=(1.0 + 3.6 * len(parts), 3.8), squeeze=False, sharey=True)
    for axis, part in zip(axes.flat, parts):
        voxels, *codes = part["rows"]
        axis.axvspan(*_PER_CORNER, color=_VTK, alpha=0.15, linewidth=0, zorder=0)
        axis.axhline(1.0, color=_GOAL, linestyle="--", linewidth=1.2, zorder=1)
        axis.loglog([r["cost"] for r in codes], [r["faster"]["ratio"] for r in codes], color=_CLVOL, marker="o",
                    markersize=4.5, linewidth=1.5, zorder=2)  # fmt: skip
        axis.loglog(codes[0]["cost"], codes[0]["faster"]["ratio"], color=_CLVOL, marker="o", markersize=9,
                    markerfacecolor="white", linestyle="", zorder=3)  # fmt: skip
        axis.loglog(voxels["cost"], voxels["faster"]["ratio"], color=_VTK, marker="s", markersize=7, linestyle="",
                    zorder=3)  # fmt: skip
        axis.set_title(part["scene"], fontsize=9)
        _grid(axis)
        axis.set_xlabel("cost of a sample, times a voxel's")
        if axis is axes.flat[0]:
            axis.set_ylabel("ray caster's time / pyramid's time")
        _plain_log(axis)
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=_VTK, marker="s", markersize=7, linestyle="", label="voxels"),
        Line2D([], [], color=_CLVOL, marker="o", markersize=9, markerfacecolor="white", linestyle="",
               label="codes on the device, in bricks"),
        Line2D([], [], color=_CLVOL, marker="o", markersize=4.5, label="the same, with more look-ups per sample"),
        Line2D([], [], color=_VTK, alpha=0.3, linewidth=8, label="2 to 4 codebooks looked up per corner"),
        Line2D([], [], color=_GOAL, linestyle="--", label="above it the pyramid is faster"),
    ]  # fmt: skip
    axes.flat[0].legend(handles=handles, loc="upper left", fontsize=7)
    return _save(plt, figure, path, _notes(result))
