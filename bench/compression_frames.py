"""Frames of volumes that are held as codes, beside frames of the voxels. Seconds are those of a frame with everything
compiled and, of "upload", decoded; "resident" decodes in a frame what that frame needs."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bench.compression_crossover import QUICK_REPEATS, REPEATS, crossover
from bench.compression_rates import QUICK_EDGE, middle
from bench.effects import ratio_of
from bench.multiresolution_scenes import CHEST_BLOCKS, CRAB, FEMALE, BlockScene, placed_as_in_bench
from bench.options import Options
from bench.report import say
from clvol.accuracy.timing import take_turns

ENGINE, HEPTANE = placed_as_in_bench("engine-smooth"), placed_as_in_bench("heptane")
# What voxels are encoded to: bits per voxel, and within a budget a largest error. Of the same bytes, a bound leaves
# less in pictures than a mean error does: few voxels that are far off show most.
BUDGET_ERROR = 0.01
RATES = {"engine-smooth": 0.45, "heptane": 0.18, "chest": 1.0, "female": 1.0}
FRAMES, CROSSOVER = (ENGINE, CHEST_BLOCKS), (ENGINE, HEPTANE, FEMALE)
BUDGETS = ((CHEST_BLOCKS, 11.0), (FEMALE, 11.0), (CRAB, 9.0))  # voxels' bytes over those allowed
QUICK_RATIO = 4.0
_SLOW = 0.6  # seconds of a frame from which three frames must do

Tables = dict[str, Any]


def cases(
    device: Any, size: int, rounds: int, folder: Path, options: Options, missing: list[str]
) -> dict[str, list[Callable[[], Any]]]:
    """What each part measures, in order, by the part's name. ``folder``: for stores of codes."""
    from bench.multiresolution import there

    scenes = {scene.name for scene in there((ENGINE, HEPTANE, FEMALE, CRAB, CHEST_BLOCKS), options, missing)}
    bench = Frames(device, size, rounds, folder, QUICK_EDGE if options.quick else None)
    repeats = QUICK_REPEATS if options.quick else REPEATS
    return {
        "frames": [lambda s=scene: frames(bench, s) for scene in FRAMES if scene.name in scenes],
        "crossover": [lambda s=scene: crossover(bench, s, repeats) for scene in CROSSOVER if scene.name in scenes],
        "budget": [
            lambda s=scene, r=QUICK_RATIO if options.quick else ratio: budget(bench, s, r)
            for scene, ratio in BUDGETS if scene.name in scenes
        ],
    }


class Frames:
    """What all parts share. ``edge``: voxels per axis that are taken of a volume, None for all."""

    def __init__(self, device: Any, size: int, rounds: int, folder: Path, edge: int | None = None) -> None:
        self.device, self.size, self.rounds, self.folder, self.edge = device, size, rounds, folder, edge
        self._volumes: dict[str, Any] = {}

    def volume(self, scene: BlockScene) -> Any:
        file = scene.scene.file
        if file not in self._volumes:
            found = scene.scene.load()
            self._volumes = {file: middle(found, self.edge) if self.edge else found}  # one at a time: they are large
        return self._volumes[file]

    def codes(self, scene: BlockScene, target: Mapping[str, float] | None = None) -> Any:
        """The volume as a store of codes ("rvq") that keeps to ``target`` (None: the rate of the scene), made at the
        first call."""
        from clvol import load_volume
        from clvol.integrators.decoding import trainer
        from clvol.opencl.context import DeviceContext
        from clvol.store.build import build_store
        from clvol.store.codecs.coded_blocks import RateTarget

        target = {"bits_per_voxel": RATES[scene.name]} if target is None else target
        name = "-".join(f"{key}-{value:g}" for key, value in target.items())
        path = self.folder / f"{scene.scene.file}-{name}.zarr"
        if not path.exists():
            encoding = trainer(DeviceContext(self.device))
            build_store(self.volume(scene), path, codec="rvq", target=RateTarget(**target), trainer=encoding)
        return load_volume(path)

    def compare(self, asked: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """A frame of every one of the scenes ``asked``, and their times, taking turns. What is refused is left out."""
        from clvol import Renderer
        from clvol.errors import ClvolError

        renderers, found = {}, {}
        with contextlib.ExitStack() as stack:
            for way, scene in asked.items():
                try:
                    renderers[way] = stack.enter_context(Renderer(scene, [self.device]))
                    found[way] = renderers[way].render(depth=False)
                except ClvolError as error:
                    say(f"{way} is left out: {error}")
                    renderers.pop(way, None)
            turns = {
                way: lambda r=renderer: r.render(depth=False).stats["seconds"]["render"]
                for way, renderer in renderers.items()
            }
            times = take_turns(turns, self.rounds, slow_seconds=_SLOW)
        return found, times


def decoding(way: str) -> Tables:
    return {"compression": {"decode": way}}


def frames(bench: Frames, scene: BlockScene) -> dict[str, Any]:
    """The ray caster on voxels, on voxels decoded when they were uploaded, and on codes that stay on the device."""
    codes = bench.codes(scene)
    found, times = bench.compare({
        "voxels": scene.plain(bench.volume(scene), bench.size),
        **{way: scene.plain(codes, bench.size, decoding(way)) for way in ("upload", "resident")},
    })
    measured = codes.blocks_source.codes.measured
    row = {
        "scene": scene.name, "bits": RATES[scene.name],
        "store": {
            "bits": measured.bits_per_voxel, "bits_all": measured.facts["bits_per_voxel_all"],
            "psnr": measured.psnr if math.isfinite(measured.psnr) else None, "largest": measured.max_voxel_error,
        },
        "ways": {
            way: {
                "time": times[way], **ratio_of(times[way], times["voxels"]),
                "compression": found[way].stats.get("compression"), **_apart(found[way], found["voxels"]),
            }
            for way in found
        },
        "same": all((found["upload"].rgba == frame.rgba).all() for way, frame in found.items() if way != "voxels"),
    }  # fmt: skip
    for way, told in row["ways"].items():
        say(f"{scene.name}, {way}: {told['ratio']:.2f} times the time of voxels")
    return row


def budget(bench: Frames, scene: BlockScene, ratio: float) -> dict[str, Any]:
    """Blocks of several resolutions within 1/``ratio`` of the voxels' bytes, as voxels and as codes, beside all voxels
    at full resolution."""
    from clvol import Renderer

    volume = bench.volume(scene)
    memory, codes = int(volume.nbytes / ratio), bench.codes(scene, {"max_voxel_error": BUDGET_ERROR})
    asked = {
        "voxels": scene.asked(volume, bench.size, memory),
        "rvq": scene.asked(codes, bench.size, memory, decoding("resident")),
    }
    with Renderer(scene.plain(volume, bench.size), [bench.device]) as renderer:
        whole = renderer.render(depth=False)
    found, times = bench.compare(asked)
    row = {
        "scene": scene.name, "ratio": ratio, "memory": memory, "asked": BUDGET_ERROR,
        "bits": codes.blocks_source.codes.measured.bits_per_voxel,
        "ways": {way: {"time": times[way], **_apart(found[way], whole)} for way in found},
    }  # fmt: skip
    for way, told in row["ways"].items():
        apart = f"CIEDE2000 {told['delta_e']:.2f}, largest {told['delta_e_largest']:.1f}"
        say(f"{scene.name} {ratio:g} : 1, {way}: {apart}")
    return row


def _apart(frame: Any, other: Any) -> dict[str, float]:
    from clvol.accuracy.metrics import delta_e

    if frame is other:
        return {"delta_e": 0.0, "delta_e_largest": 0.0}
    apart = delta_e(frame.rgba, other.rgba)
    return {"delta_e": float(apart.mean()), "delta_e_largest": float(apart.max())}
