"""How far the inner loop is from what the machine can fetch.

The same rays and the same number of samples, from the least to all of the work:
  gathers alone     the gathers that a sample needs, from 16 KiB (L1), and one addition each
  sampling in L1    trilinear sampling in full, but every address within a few bytes of the first
  sampling          trilinear sampling of the volume, summed
  ray caster        classification, compositing and the transfer too; no skipping, no stopping
and the ray caster as it is used, which skips and stops. Nanoseconds a sample and core: seconds
times compute units over samples.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from bench.options import Options
from bench.report import load_average, machine, say, table
from bench.scenes import SCENES
from clvol.accuracy.timing import take_turns

SUMMARY = "the trilinear sampling alone, beside the whole loop and the machine's gathers"
SCENE_NAMES = ("engine-smooth", "heptane")
RUNGS = ("gathers alone", "sampling in L1", "sampling", "ray caster")


def _arguments(voxel_bits: int) -> tuple:
    """Of both kernels, which add up over tiles."""
    from clvol.device.arguments import view_argument
    from clvol.opencl.arguments import RAW, reads, writes

    sums = (writes("sums", np.float32, "tiles"), writes("samples", np.uint32, "tiles"))
    return (reads("volume", RAW), view_argument(voxel_bits), *sums)


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.context import DeviceContext
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    result: dict[str, Any] = {
        "machine": machine(device), "load_before": load_average(), "quick": options.quick,
        "size": 128 if options.quick else 512, "scenes": [],
    }  # fmt: skip
    wanted = [s for s in SCENES if s.name in (options.scenes or SCENE_NAMES)]
    for scene in wanted:
        if not scene.path().is_file():
            say(f"{scene.name}: left out, there is no volume {scene.file} in ../shared/volumes")
            continue
        context = DeviceContext(device)
        rounds = 3 if options.quick else options.frames
        result["scenes"].append(_take_apart(scene, result["size"], context, rounds))
        context.release()
    result["load_after"] = load_average()
    return result if result["scenes"] else None


def _take_apart(scene, size: int, context, rounds: int) -> dict[str, Any]:
    from bench.programs import bench_kernels
    from clvol.device.view import ray_frame
    from clvol.integrators.raycast.caster import Raycaster
    from clvol.schedule.tiles import tiling

    resolved = scene.scene(scene.load(), size).resolve()
    endless = replace(
        resolved, integration=resolved.integration.model_copy(update={"early_termination": 0.0})
    )
    plain = Raycaster(context, endless, skip=False)
    used = Raycaster(context, resolved, volume=plain.volume)
    sum_samples, sum_gathers = bench_kernels(
        context,
        "sampling.cl",
        dict.fromkeys(("sum_samples", "sum_gathers"), _arguments(plain.switches["VOXEL_BITS"])),
        plain.switches,
    )
    # The view struct that the ray caster itself would use; in L1, all strides are one voxel.
    cut = tiling(size, size, *plain.tile)
    frame = ray_frame(resolved.camera, resolved.volume.grid, size, size)
    view = plain.frame_view(frame, size, size)
    near = view.copy()
    near["row_stride"] = near["slice_stride"] = 1
    views = {"whole": context.upload(view), "near": context.upload(near)}
    sums = context.empty(np.float32, (cut.rows, cut.columns))
    counts = context.empty(np.uint32, (cut.rows, cut.columns))
    samples: dict[str, int] = {}

    def launch(name: str, kernel, which: str):
        def call() -> float:
            start = time.perf_counter()
            kernel(
                context.queue,
                (cut.columns, cut.rows),
                (1, 1) if plain.lanes > 1 else None,
                sizes={"tiles": cut.count},
                volume=plain.volume.voxels,
                view=views[which],
                sums=sums,
                samples=counts,
            )
            context.finish()
            seconds = time.perf_counter() - start
            samples[name] = int(context.read(counts).sum(dtype=np.uint64))
            return seconds

        return call

    def picture(name: str, raycaster):
        def call() -> float:
            start = time.perf_counter()
            samples[name] = raycaster.render(resolved.camera, size, size).samples
            return time.perf_counter() - start

        return call

    calls = {
        "gathers alone": launch("gathers alone", sum_gathers, "whole"),
        "sampling in L1": launch("sampling in L1", sum_samples, "near"),
        "sampling": launch("sampling", sum_samples, "whole"),
        "ray caster": picture("ray caster", plain),
        "as used": picture("as used", used),
    }
    for call in calls.values():
        call()
    times = take_turns(calls, rounds)
    cores = context.device.max_compute_units
    measured = {
        name: {
            "name": name,
            "seconds": times[name]["median"],
            "time": times[name],
            "samples": samples[name],
            "ns_a_sample_and_core": times[name]["median"] * cores / samples[name] * 1e9,
        }
        for name in calls
    }
    return {
        "scene": scene.name,
        "cores": cores,
        "rungs": [measured[name] for name in RUNGS],
        "as_used": measured["as used"],
    }


def show(result: dict[str, Any]) -> str:
    rows = []
    for s in result["scenes"]:
        limit = s["rungs"][0]["ns_a_sample_and_core"]
        for r in (*s["rungs"], s["as_used"]):
            ns = r["ns_a_sample_and_core"]
            rows.append([
                s["scene"], "ray caster as used" if r is s["as_used"] else r["name"],
                f"{r['samples'] / 1e6:.2f}", f"{r['seconds']:.4f}", f"{ns:.2f}",
                f"{ns / limit:.1f}",
            ])  # fmt: skip
    head = ["scene", "work", "million samples", "seconds", "ns a sample and core", "x gathers"]
    return "\n".join([
        f"{result['size']} x {result['size']} pixels, step 1",
        table(head, rows, left=2),
        f"load average {result['load_before']} to {result['load_after']}",
    ])


def draw(result: dict[str, Any], options: Options) -> list:
    from bench.charts import ladder_chart

    return [ladder_chart(result, options.folder / "sampling.png")]
