"""How cost grows: the time of a frame against the samples it takes.

A smooth procedural field, translucent everywhere, so that nothing can be skipped and no ray stops:
volumes of 64³ to 512³ at 512² pixels, and pictures of 128² to 2048² of the volume of 256³. The
opacity unit grows with the volume, so that all pictures look alike.
"""

from __future__ import annotations

from typing import Any

from bench.options import Options
from bench.report import load_average, machine, say, table
from bench.scenes import camera
from clvol.accuracy.timing import take_turns

SUMMARY = "time and samples against volume size and image size"
VOLUME_EDGES, IMAGE_EDGES = (64, 128, 256, 384, 512), (128, 256, 512, 1024, 2048)
MIDDLE = {"volume": 256, "image": 512}
QUICK_EDGES, QUICK_MIDDLE = (32, 64), {"volume": 64, "image": 64}


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    edges = (QUICK_EDGES, QUICK_EDGES) if options.quick else (VOLUME_EDGES, IMAGE_EDGES)
    middle = QUICK_MIDDLE if options.quick else MIDDLE
    rounds = 3 if options.quick else options.frames
    result: dict[str, Any] = {
        "machine": machine(device), "load_before": load_average(), "quick": options.quick,
        "middle": middle, "volume": [], "image": [],
    }  # fmt: skip
    for edge in edges[0]:
        volume = procedural_volume(edge)
        result["volume"].append({"edge": edge, **_frame(volume, middle["image"], device, rounds)})
        say(f"volume {edge}: {result['volume'][-1]['seconds']:.4f} s")
        if edge == middle["volume"]:
            kept = volume
        del volume
    for edge in edges[1]:
        result["image"].append({"edge": edge, **_frame(kept, edge, device, rounds)})
        say(f"image {edge}: {result['image'][-1]['seconds']:.4f} s")
    result["load_after"] = load_average()
    return result


def procedural_volume(edge: int):
    """``edge``³ voxels, uint8, of a smooth field that is the same for every edge; spacing 1."""
    from clvol import Volume
    from clvol.volume.procedural import Smooth, sample, unit_box

    shape = (edge,) * 3
    spacing, origin = unit_box(shape)
    field = Smooth(
        waves=((9.0, 0.0, 5.0), (0.0, 7.0, -9.0), (3.0, 6.0, 4.0)),
        amplitudes=(50.0, 40.0, 30.0), offset=127.5,
    )  # fmt: skip
    volume = sample(field, shape, spacing, origin, dtype="uint8")
    return Volume(volume.data, name=f"smooth field, {edge}")


def _frame(volume, size: int, device, rounds: int) -> dict[str, Any]:
    from clvol import Renderer, Scene

    edge = volume.shape[0]
    points = (
        (0.0, 0.2, (0.1, 0.2, 0.8)), (127.0, 0.5, (0.2, 0.8, 0.3)), (255.0, 0.8, (1.0, 0.4, 0.1)),
    )  # fmt: skip
    scene = Scene(
        volume=volume,
        camera=camera(volume),
        image={"width": size, "height": size},
        transfer_function={
            "opacity_unit": edge / 2.0,
            "color_space": "linear",
            "points": [{"value": v, "opacity": o, "color": list(c)} for v, o, c in points],
        },
        integration={"early_termination": 0.0},
    )
    with Renderer(scene, [device]) as renderer:
        samples = renderer.render(depth=False).stats["samples"]
        times = take_turns({0: lambda: renderer.render(depth=False).stats["seconds"]["render"]}, rounds)[0]
    ns = times["median"] * device.max_compute_units / samples * 1e9
    return {
        "seconds": times["median"], "time": times, "samples": samples, "ns_a_sample_and_core": ns,
    }  # fmt: skip


def show(result: dict[str, Any]) -> str:
    rows = []
    for key, unit in (("volume", "³ voxels"), ("image", "² pixels")):
        for p in result[key]:
            rows.append([
                f"{p['edge']}{unit}", f"{p['samples'] / 1e6:.2f}", f"{p['seconds']:.4f}",
                f"{p['ns_a_sample_and_core']:.2f}",
            ])  # fmt: skip
    costs = [p["ns_a_sample_and_core"] for key in ("volume", "image") for p in result[key]]
    middle = result["middle"]
    return "\n".join([
        f"Volumes at {middle['image']}² pixels, pictures of {middle['volume']}³ voxels.",
        table(["what", "million samples", "seconds", "ns a sample and core"], rows),
        f"dearest sample over cheapest: {max(costs) / min(costs):.2f};"
        f" load average {result['load_before']} to {result['load_after']}",
    ])


def draw(result: dict[str, Any], options: Options) -> list:
    from bench.charts import scaling_chart

    return [scaling_chart(result, options.folder / "scaling.png")]
