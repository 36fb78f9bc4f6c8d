"""What is measured of the method "multiresolution", part by part; figures only, see multiresolution_tables.py.

A part compares renderers that take turns, at the same blocks in the same minutes. Seconds are wall time of a
picture without depths, compiled and resident.
"""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from bench.effects import ratio_of
from bench.multiresolution_scenes import BlockScene
from bench.report import say
from clvol.accuracy.metrics import delta_e, ssim
from clvol.accuracy.timing import summary, take_turns
from clvol.store.source import DROPPED, BlockStatistics
from clvol.store.volume_blocks import VolumeBlocks

STEPPINGS = ("full", "limited", "naive", "bounded")
SLICES = "slices"  # beside them: as texture slicing in the paper's table
PRIORITIES, TILE_SIZES = ("max", "average", "rms"), (8, 12, 16, 24)
SHARE_GOAL, HIGHEST = 0.37, 0.9  # of pixels with a ray; tile_high as in the paper
_SLOW = 0.6  # seconds of a frame from which three frames must do
MiB = 2**20
# As in the paper: levels chosen by the transfer function alone.
AS_IN_PAPER = {"view_weighting": False, "occlusion": False}
PAPER_STEP = 0.5  # voxel edges; the paper does not say. Long steps are multiples of it


@dataclass
class Bench:
    """What all parts share. ``folder``: for stores and other files that parts make."""

    device: Any
    size: int
    rounds: int
    folder: Path

    def __post_init__(self) -> None:
        from clvol.opencl.context import DeviceContext

        self.context = DeviceContext(self.device)
        self._volumes: dict[str, Any] = {}

    def volume(self, scene: BlockScene) -> Any:
        """With the blocks' statistics found once for all parts."""
        file = scene.scene.file
        if file not in self._volumes:
            found = scene.scene.load()
            found.blocks_source = KnownBlocks(found)
            self._volumes[file] = found
        return self._volumes[file]

    @contextlib.contextmanager
    def blocks(self, resolved: Any) -> Iterator[Blocks]:
        found = Blocks(self.context, resolved)
        try:
            yield found
        finally:
            found.residency.blocks.close()
            gc.collect()

    def times(self, turns: Mapping[Any, Callable[[], float]]) -> dict[Any, dict[str, Any]]:
        return take_turns(turns, self.rounds, slow_seconds=_SLOW)


class KnownBlocks(VolumeBlocks):
    """A volume in memory as blocks whose statistics are found once."""

    def statistics(self) -> Iterator[BlockStatistics]:
        if not hasattr(self, "_known"):
            self._known = list(super().statistics())
        return iter(self._known)


class Blocks:
    """A scene's blocks on a device, and what renders them: ``caster``."""

    def __init__(self, context: Any, resolved: Any) -> None:
        from clvol.integrators.multiresolution.residency import Residency

        self.context, self.resolved = context, resolved
        self.residency = Residency(context, resolved)
        self.residency.ask(resolved)

    def hold(self, levels: np.ndarray) -> None:
        """``levels`` instead of those that were selected."""
        known = self.residency.source.statistics()
        means = np.concatenate([part.mean[-1] for part in known])
        self.residency.blocks.load(levels, means)
        self.residency.blocks.commit()

    def asked(self, **settings: Any) -> Any:
        table = self.resolved.multiresolution.model_copy(update=settings)
        return replace(self.resolved, multiresolution=table)

    def caster(self, skip: bool = True, **settings: Any) -> Any:
        from clvol.integrators.multiresolution.caster import BlockCaster
        from clvol.integrators.multiresolution.engine import caster_of

        asked = self.asked(**settings)
        kind = caster_of(asked)
        how = {"skip": skip} if kind is BlockCaster else {}
        made = kind(self.context, asked, self.residency.blocks, **how)
        made.warm_up(*self.size, depth=False)
        return made

    @property
    def size(self) -> tuple[int, int]:
        image = self.resolved.image
        return image.width, image.height

    def picture(self, renderer: Any) -> Any:
        return renderer.render(self.resolved.camera, *self.size, depth=False)

    def turn(self, renderer: Any) -> Callable[[], float]:
        return timed(lambda: self.picture(renderer))

    def described(self) -> dict[str, Any]:
        """``Residency.describe``, and the voxels' bytes over those of what is resident."""
        found = self.residency.describe()
        voxels = self.resolved.volume.nbytes
        return {**found, "reduction": voxels / max(found["bytes_of_samples"], 1)}


def timed(call: Callable[[], Any]) -> Callable[[], float]:
    """Gives the seconds that ``call`` takes."""

    def turn() -> float:
        start = perf_counter()
        call()
        return perf_counter() - start

    return turn


def alike(picture: np.ndarray, other: np.ndarray) -> dict[str, float]:
    """As displayed over black."""
    if picture is other:
        return {"ssim": 1.0, "delta_e": 0.0}
    return {"ssim": ssim(picture, other), "delta_e": float(delta_e(picture, other).mean())}


# Along the ray


def stepping(
    bench: Bench, scene: BlockScene, ratio: float, as_in_paper: bool, goal: float | None
) -> dict[str, Any]:
    """Every way to step over "full", at the same blocks: ``ratio`` : 1 of the voxels' bytes."""
    volume = bench.volume(scene)
    settings = AS_IN_PAPER if as_in_paper else {}
    asked = scene.asked(volume, bench.size, int(volume.nbytes / ratio), **settings).resolve()
    step = PAPER_STEP if as_in_paper else asked.integration.step
    asked = replace(asked, integration=asked.integration.model_copy(update={"step": step}))
    with bench.blocks(asked) as blocks:
        casters = {name: blocks.caster(skip=not as_in_paper, stepping=name) for name in STEPPINGS}
        if getattr(casters["bounded"], "steps", None) is None:  # steps it may take at once, by block
            del casters["bounded"]
        casters[SLICES] = _slices(blocks)
        frames = {name: blocks.picture(caster) for name, caster in casters.items()}
        times = bench.times({name: blocks.turn(caster) for name, caster in casters.items()})
        row = {
            "scene": scene.name, "ratio": ratio, "as_in_paper": as_in_paper, "goal": goal,
            "classification": scene.scene.classification, "step": step,
            "blocks": blocks.described(),
            "steppings": {
                name: stepping_row(name, frames, times) for name in casters
            },
        }  # fmt: skip
    found = row["steppings"]["limited"]
    say(f"{scene.name} {ratio:g} : 1{', as in the paper' if as_in_paper else ''}: limited"
        f" {found['faster']:.2f} times as fast, SSIM {found['ssim']:.4f}")
    return row


def _slices(blocks: Any) -> Any:
    """Texture slices of all voxels at the blocks' step: planes across the view. Where classification is pre-integrated
    both ends of each slab are sampled for it."""
    from clvol.device.volume import DeviceVolume
    from clvol.integrators.slicing.caster import SlicingCaster

    asked = blocks.resolved
    asked = replace(asked, integration=asked.integration.model_copy(update={"method": "slicing"}))
    made = SlicingCaster(blocks.context, asked, volume=DeviceVolume(blocks.context, asked.volume))
    made.switches["SLAB_SAMPLES"] = 2
    made.warm_up(*blocks.size, depth=False)
    return made


def stepping_row(
    name: str, frames: Mapping[str, Any], times: Mapping[str, dict[str, Any]]
) -> dict[str, Any]:
    """Of ``name`` beside "full". ``faster``: seconds of "full" over its own."""
    frame, full = frames[name], frames["full"]
    return {
        "time": times[name], "samples": frame.samples, "counters": frame.counters,
        "faster": times["full"]["median"] / times[name]["median"],
        "samples_ratio": full.samples / max(frame.samples, 1),
        **alike(frame.rgba, full.rgba),
    }  # fmt: skip


def interblock(bench: Bench, scene: BlockScene, ratio: float) -> list[dict[str, Any]]:
    """With interpolation between blocks over without, at the same blocks."""
    volume = bench.volume(scene)
    asked = scene.asked(volume, bench.size, int(volume.nbytes / ratio)).resolve()
    with bench.blocks(asked) as blocks:
        casters = {
            (name, on): blocks.caster(stepping=name, interblock=on)
            for name in ("full", "limited") for on in (True, False)
        }  # fmt: skip
        samples = {key: blocks.picture(caster).samples for key, caster in casters.items()}
        times = bench.times({key: blocks.turn(caster) for key, caster in casters.items()})
    return [
        {
            "scene": scene.name, "stepping": name, **ratio_of(times[name, True], times[name, False]),
            "seconds": times[name, True]["median"], "without": times[name, False]["median"],
            "samples": samples[name, True],
        }
        for name in ("full", "limited")
    ]  # fmt: skip


# In the picture


def tiles(bench: Bench, scene: BlockScene, ratio: float) -> dict[str, Any]:
    """Tiles over a ray for every pixel: every priority and size, and the one case that the goal is
    about: tiles of 16 by "max", with the highest tile_high that leaves SHARE_GOAL of the rays."""
    from clvol.integrators.tiles.tiled import TiledRenderer

    volume = bench.volume(scene)
    asked = scene.asked(volume, bench.size, int(volume.nbytes / ratio)).resolve()
    with bench.blocks(asked) as blocks:
        caster = blocks.caster()
        whole = blocks.picture(caster)

        def tiled(size: int, priority: str, high: float) -> Any:
            asked = blocks.asked(tiles=size, tile_priority=priority, tile_high=high)
            return TiledRenderer(caster, asked.multiresolution)

        def share(high: float) -> float:
            return planned_share(tiled(16, "max", high), asked.camera, *blocks.size)

        keys = [(size, priority, HIGHEST) for priority in PRIORITIES for size in TILE_SIZES]
        keys.append((16, "max", highest_within(share, SHARE_GOAL)))
        renderers = {key: tiled(*key) for key in dict.fromkeys(keys)}
        next(iter(renderers.values())).warm_up(depth=False)
        frames = {key: blocks.picture(renderer) for key, renderer in renderers.items()}
        turns = {key: blocks.turn(renderer) for key, renderer in renderers.items()}
        times = bench.times({"all": blocks.turn(caster), **turns})
        covered = float((whole.rgba[..., 3] > 0).mean())
    rows = [
        {
            "tiles": key[0], "priority": key[1], "tile_high": key[2], "share": frames[key].share,
            "time": times[key], "faster": times["all"]["median"] / times[key]["median"],
            "ssim": ssim(frames[key].rgba, whole.rgba), "is_goal": key == keys[-1],
        }
        for key in renderers
    ]  # fmt: skip
    say(f"{scene.name}, tiles of 16: {rows[-1]['share']:.0%} of the rays,"
        f" {rows[-1]['faster']:.2f} times as fast")
    return {"scene": scene.name, "ratio": ratio, "all": times["all"], "covered": covered, "rows": rows}


def planned_share(renderer: Any, camera: Any, width: int, height: int) -> float:
    """Rays planned over pixels."""
    return float(renderer.start(camera, width, height, depth=False).costs.sum()) / (width * height)


def highest_within(share: Callable[[float], float], goal: float) -> float:
    """The highest tile_high (a multiple of 0.05, up to HIGHEST) whose share of rays is at most
    ``goal``; the lowest there is where none is."""
    steps = [k / 20 for k in range(round(20 * HIGHEST), 2, -1)]
    return next((high for high in steps if share(high) <= goal), steps[-1])


# Memory


def budget(bench: Bench, scene: BlockScene, memory: int) -> dict[str, Any]:
    """A picture within ``memory`` bytes beside that of all voxels, and what is on the device."""
    volume = bench.volume(scene)
    asked = scene.asked(volume, bench.size, memory).resolve()
    full = bench.context.__class__(bench.device)
    exact = _plain_caster(full, scene.plain(volume, bench.size).resolve())
    width, height = bench.size, bench.size
    reference = exact.render(asked.camera, width, height, depth=False).rgba
    full.release()
    context = bench.context.__class__(bench.device)  # of its own: its buffers are counted
    blocks = Blocks(context, asked)
    caster = blocks.caster()
    frame = blocks.picture(caster)
    buffers = live_bytes(context)
    described = blocks.described()
    within = described["bytes_on_device"] + caster.distances.nbytes
    blocks.residency.blocks.close()
    context.release()
    apart = alike(frame.rgba, reference)
    say(f"{scene.name} in {memory / MiB:.1f} MiB: CIEDE2000 {apart['delta_e']:.2f}")
    return {
        "scene": scene.name, "memory": memory, "ratio": volume.nbytes / memory,
        **apart, "blocks": described,
        "on_device": within, "all_buffers": buffers, "picture": frame.rgba.nbytes,
    }  # fmt: skip


def live_bytes(context: Any) -> int:
    """Bytes of all buffers of ``context`` that are alive."""
    from clvol.opencl.context import DeviceArray

    gc.collect()
    found = {
        array.buffer.int_ptr: array.buffer.size
        for array in gc.get_objects()
        if isinstance(array, DeviceArray) and array.buffer.context == context.context
    }
    return sum(found.values())


def _plain_caster(context: Any, resolved: Any) -> Any:
    from clvol.integrators.raycast.caster import Raycaster

    caster = Raycaster(context, resolved)
    caster.warm_up(resolved.image.width, resolved.image.height, False)
    return caster


def resident(bench: Bench, scene: BlockScene) -> dict[str, Any]:
    """All blocks at full resolution, and those that show something, beside the plain ray caster; and
    what the method selects by itself where memory is no matter."""
    volume = bench.volume(scene)
    asked = scene.asked(volume, bench.size, 2 * volume.nbytes + 64 * MiB).resolve()
    plain = _plain_caster(bench.context, scene.plain(volume, bench.size).resolve())
    with contextlib.ExitStack() as stack:
        every, shown, chosen = (stack.enter_context(bench.blocks(asked)) for _ in range(3))
        selected = chosen.residency.selection.levels
        every.hold(np.zeros_like(selected))
        shown.hold(np.where(selected == DROPPED, DROPPED, 0).astype(np.uint8))
        casters = {
            "plain": plain, "all": every.caster(stepping="full"),
            "shown": shown.caster(stepping="full"), "selected": chosen.caster(),
        }  # fmt: skip
        frames = {name: chosen.picture(caster) for name, caster in casters.items()}
        times = bench.times({name: chosen.turn(caster) for name, caster in casters.items()})
        held = {"all": every, "shown": shown, "selected": chosen}
        rows = {
            name: {
                **ratio_of(times[name], times["plain"]), "seconds": times[name]["median"],
                "samples": frames[name].samples, "bytes": blocks.described()["bytes_of_samples"],
                **alike(frames[name].rgba, frames["plain"].rgba),
            }
            for name, blocks in held.items()
        }  # fmt: skip
    say(f"{scene.name}, fully resident: {rows['all']['ratio']:.2f} times the plain time")
    return {
        "scene": scene.name, "seconds": times["plain"]["median"], "time": times["plain"],
        "samples": frames["plain"].samples, "rows": rows,
        "dropped": float((selected == DROPPED).mean()),
    }  # fmt: skip


# Selection


def selection(bench: Bench, scene: BlockScene, memory: int, **settings: Any) -> dict[str, Any]:
    """How near to the best possible the selected levels are, and how long finding them takes."""
    from clvol.integrators.multiresolution.sample_allocator import overhead_bytes
    from clvol.integrators.multiresolution.selection import select_blocks, source_errors

    volume = bench.volume(scene)
    asked = scene.asked(volume, bench.size, memory, **settings).resolve()
    source, function = volume.blocks_source, asked.transfer_function
    seen = asked.camera if asked.multiresolution.view_weighting else None
    start = perf_counter()
    known = source_errors(source, function, asked.background)
    errors_seconds = perf_counter() - start
    spare = memory - overhead_bytes(source.blocks, memory)
    start = perf_counter()
    found = select_blocks(
        source, function, asked.background, seen, asked.image, spare,
        occlusion=asked.multiresolution.occlusion, known=known,
    )  # fmt: skip
    return {
        "scene": scene.name, "memory": memory, "by_view": seen is not None,
        "blocks": source.blocks.count, "error": found.error, "bound": found.bound,
        "errors_seconds": errors_seconds, "seconds": perf_counter() - start,
    }  # fmt: skip


def changed_function(bench: Bench, scene: BlockScene, other: BlockScene, memory: int, store: Path
                     ) -> dict[str, Any]:  # fmt: skip
    """Another transfer function while frames (of half the size) go on: how long until its blocks are
    there, what is read from the disk for it, and how long frames take meanwhile. ``store``: of the
    scenes' volume."""
    from clvol import Renderer, load_volume
    volume = load_volume(store)
    size = bench.size // 2
    scene_asked = scene.asked(volume, size, memory)
    function = other.asked(volume, size, memory).resolve().transfer_function
    with Renderer(scene_asked, [bench.device]) as renderer:
        residency = renderer._on_device.prepared.residency
        idle = [_seconds(renderer) for _ in range(bench.rounds + 1)][1:]
        before = residency.blocks.levels
        start = perf_counter()
        renderer.set_transfer_function(function, wait=False)
        asked = perf_counter() - start
        frames: list[float] = []
        while residency.blocks.pending:
            frames.append(_seconds(renderer))
        whole = perf_counter() - start
        after = residency.blocks.levels
        edge, itemsize = residency.source.blocks.edge, residency.blocks.samples[0].dtype.itemsize
    read = (after != before) & (after != DROPPED) & (edge >> np.minimum(after, 31) > 1)
    samples = (edge >> after[read].astype(np.int64)) ** 3
    say(f"another transfer function: {whole:.2f} s, {len(frames)} frames meanwhile")
    return {
        "scene": scene.name, "other": other.name, "memory": memory, "size": size,
        "asked_seconds": asked,
        "seconds": whole, "changed": int((after != before).sum()), "blocks": len(after),
        "read_blocks": int(read.sum()), "read_bytes": int(samples.sum()) * itemsize,
        "all_bytes": residency.blocks.sample_bytes,
        "idle": summary(idle), "frames": summary(frames) if frames else None,
    }  # fmt: skip


def _seconds(renderer: Any) -> float:
    start = perf_counter()
    renderer.render(depth=False)
    return perf_counter() - start
