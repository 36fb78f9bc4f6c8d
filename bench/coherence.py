"""Rays that start where those of the picture before first contributed, beside leaps over empty space: table 1 of Klein
et al. (IEEE Visualization 2005), with stand-ins for the volumes that are not at hand.

The camera turns about y; pictures of 512 by 512 are taken in short runs at places around the turn, one after another
within a run. Columns: nothing (every ray from the hull, sample after sample), leaps (each ray leaps over empty space),
cells (packets leap first, which is what a user gets), coherence alone, and both: coherence with leaps and cells.

Coherence is as in the paper here, without an audit: "differ" is the mean number of pixels of a picture that are not,
bit for bit, those from the hull, "same bits" in how many pictures there are none.

What is counted is processor time of whole calls, host and kernels, the columns in turns within each picture, as
medians; and samples (of surfaces: cells that were looked into) per pixel whose ray meets the volume. "in 10": the share
of packets of 4 by 4 such pixels that took at most 10 samples per pixel.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.effect_scenes import LIGHT
from bench.options import Options
from bench.report import closing, load_average, opening, say, table
from bench.scenes import CHEST, OPACITY_UNIT, SCENES, VOLUMES, camera
from clvol.device.empty_space import distance_map
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.history import History
from clvol.integrators.raycast.measured_gain import MeasuredGain

SUMMARY = "coherence from frame to frame, beside leaps over empty space (Klein et al. 2005, table 1)"
SIZE, DEGREES, PLACES, RUN = 512, 0.5, 3, 4
QUICK_SIZE, QUICK_PLACES, QUICK_RUN = 64, 1, 2
NO_AUDIT = 65536  # more than there are packets
FEW = 10  # samples per pixel
COLUMNS = {
    "nothing": (False, "off"), "leaps": (True, "off"), "cells": (True, "cells"),
    "coherence": (False, "reproject"), "both": (True, "reproject"),
}  # fmt: skip


@dataclass(frozen=True)
class Row:
    """``step`` and ``paper`` (the speed-up there, without leaps) of a row of the table. ``value``: of the surface, as a
    share of the range; None: semi-transparent, by the transfer function of a bench scene or above a value."""

    name: str
    file: str
    step: float
    paper: float
    value: float | None = None
    points: tuple = ()


def _ramp(low: float, high: float) -> tuple:
    return (low, 0.0, (0.8, 0.5, 0.3)), (high, 0.4, (1.0, 0.9, 0.8))


_POINTS = {scene.name: scene.points for scene in (*SCENES, CHEST)}
ROWS = (
    Row("engine iso", "engine.nrrd", 0.5, 1.8, value=0.5),
    Row("cthead iso (head)", "cthead.nrrd", 0.5, 2.2, value=0.3),
    Row("vismale iso (foot)", "vismale.nrrd", 0.4, 2.7, value=0.4),
    Row("vismale semi (foot)", "vismale.nrrd", 0.8, 1.4, points=_POINTS["vismale"]),
    Row("chest iso (abdomen)", "chest.nrrd", 0.7, 2.7, value=0.45),
    Row("chest semi (abdomen)", "chest.nrrd", 0.7, 1.2, points=_POINTS["chest"]),
    Row("aneurism semi", "aneurism.nrrd", 0.5, 1.7, points=_POINTS["aneurism"]),
    Row("aneurism semi", "aneurism.nrrd", 1.0, 1.7, points=_POINTS["aneurism"]),
    Row("teapot semi (backpack)", "teapot.nrrd", 1.0, 1.5, points=_ramp(40.0, 255.0)),
)


class Counting(Raycaster):
    """Keeps the samples of each tile of its last picture. Without leaps, it does not leap to surfaces, either."""

    def _surface_cells(self) -> np.ndarray:
        mask = super()._surface_cells()
        if not self.skip:
            self.effects.set_surfaces(distance_map(self.context, np.ones_like(mask)))
        return mask

    def launches(self, name, view, tiles, depth, progress, outputs, *more):  # type: ignore[no-untyped-def]
        self.samples = outputs["samples"]
        return super().launches(name, view, tiles, depth, progress, outputs, *more)


class Always(MeasuredGain):
    """Takes starts whether or not they gain anything."""

    def turn(self) -> str | None:
        return None


def _history() -> History:
    history = History()
    history.gain = Always()
    return history


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.context import DeviceContext
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    context = DeviceContext(device)
    size = QUICK_SIZE if options.quick else SIZE
    result, begun = opening(device, options.quick, size) | {"rows": []}, time.perf_counter()
    rows = ROWS[:1] if options.quick else ROWS
    for row in rows:
        if options.scenes and row.file.removesuffix(".nrrd") not in options.scenes:
            continue
        if not (VOLUMES / row.file).is_file():
            say(f"{row.name}: left out, there is no volume {row.file} in ../shared/volumes")
            continue
        found = measure(context, row, size, options.quick)
        result["rows"].append(found)
        say(line(found))
    context.release()
    result |= {"seconds": time.perf_counter() - begun, "load_after": load_average()}
    return result if result["rows"] else None


def scene_of(row: Row, size: int) -> Any:
    """The scene of a row, resolved."""
    from clvol import Scene, Volume, load_volume

    found = load_volume(VOLUMES / row.file)
    volume = Volume(found.data, spacing=found.grid.spacing, name=row.file)
    low, high = volume.value_range
    points = row.points or ((low, 0.0, (0.0, 0.0, 0.0)),)
    tables: dict[str, Any] = {}
    if row.value is not None:
        tables = {"isosurface": [{"value": low + row.value * (high - low)}], "light": [LIGHT]}
    return Scene(
        volume=volume, camera=camera(volume), image={"width": size, "height": size},
        transfer_function={
            "opacity_unit": OPACITY_UNIT, "color_space": "linear",
            "points": [{"value": float(v), "opacity": float(o), "color": list(c)} for v, o, c in points],
        },
        integration={"step": row.step, "step_error": 0.0}, **tables,
    ).resolve()  # fmt: skip


def measure(context: Any, row: Row, size: int, quick: bool) -> dict[str, Any]:
    from clvol.scene.coherence import Coherence
    from clvol.schedule.animation import orbited

    resolved = scene_of(row, size)
    casters = {
        name: Counting(context, replace(resolved, coherence=Coherence(mode=mode, audit=NO_AUDIT)), skip=skip,
                       history=_history(), tile=(16, 16) if skip else (4, 4))
        for name, (skip, mode) in COLUMNS.items()
    }  # fmt: skip
    for caster in casters.values():
        caster.warm_up(size, size, depth=False)
    seconds: dict[str, list[float]] = {name: [] for name in COLUMNS}
    samples: dict[str, list[float]] = {name: [] for name in COLUMNS}
    few: dict[str, list[float]] = {name: [] for name, (skip, _) in COLUMNS.items() if not skip}
    differ = []
    for place in range(QUICK_PLACES if quick else PLACES):
        for step in range(1 + (QUICK_RUN if quick else RUN)):
            view = orbited(resolved.camera, 360.0 * place / PLACES + DEGREES * step)
            on_volume = _meets(view, resolved.volume.grid, size)
            pictures = {}
            for name, caster in casters.items():
                begun = time.process_time()
                data = caster.render(view, size, size, depth=False)
                taken = time.process_time() - begun
                pictures[name] = data.rgba
                if not step:  # the first of a run has none before it
                    continue
                seconds[name].append(taken)
                samples[name].append(data.samples / max(on_volume.sum(), 1))
                if name in few:  # whose tiles are packets
                    packets = context.read(caster.samples).reshape(size // 4, size // 4) / 16
                    whole = on_volume.reshape(size // 4, 4, size // 4, 4).all(axis=(1, 3))
                    few[name].append(float((packets[whole] <= FEW).mean()))
            if step:
                expected = pictures["cells"].view(np.uint32)
                differ.append(int(np.any(pictures["both"].view(np.uint32) != expected, axis=-1).sum()))
                assert (pictures["leaps"].view(np.uint32) == expected).all()
    return {
        "name": row.name, "file": row.file, "step": row.step, "paper": row.paper,
        "seconds": {name: statistics.median(each) for name, each in seconds.items()},
        "samples": {name: statistics.mean(each) for name, each in samples.items()},
        "few": {name: statistics.mean(each) for name, each in few.items()},
        "differ": statistics.mean(differ), "pictures": len(differ), "exact": sum(not each for each in differ),
    }  # fmt: skip


def _meets(view: Any, grid: Any, size: int) -> np.ndarray:
    """bool [size, size]: pixels whose rays meet the volume (its axes along the world's)."""
    origins, directions = view.world_rays(size, size)
    low, high = grid.world_corners().min(axis=0), grid.world_corners().max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origins) / directions, (high - origins) / directions
    return np.minimum(a, b).max(axis=-1) < np.maximum(a, b).min(axis=-1)


def gains(row: dict[str, Any]) -> dict[str, float]:
    """Speed-ups: of coherence without leaps, of both over leaps and over cells, and of cells over leaps."""
    s = row["seconds"]
    return {
        "coherence": s["nothing"] / s["coherence"], "both": s["leaps"] / s["both"],
        "beside cells": s["cells"] / s["both"], "cells": s["leaps"] / s["cells"],
    }  # fmt: skip


def line(row: dict[str, Any]) -> str:
    told = ", ".join(f"{name} {1e3 * seconds:.1f} ms" for name, seconds in row["seconds"].items())
    return f"{row['name']}, step {row['step']:g}: {told}; {row['differ']:.1f} pixels differ"


def show(result: dict[str, Any]) -> str:
    cells = []
    for row in result["rows"]:
        gain = gains(row)
        cells.append([
            row["name"], f"{row['step']:g}",
            *(f"{1e3 * row['seconds'][name]:.1f}" for name in COLUMNS),
            f"{gain['coherence']:.2f}", f"{row['paper']:g}", f"{gain['both']:.2f}", f"{gain['cells']:.2f}",
            *(f"{row['samples'][name]:.1f}" for name in ("nothing", "leaps", "coherence", "both")),
            f"{row['few']['nothing']:.0%}", f"{row['few']['coherence']:.0%}", f"{row['differ']:.1f}",
            f"{row['exact']} of {row['pictures']}",
        ])  # fmt: skip
    head = ["row", "step", *(f"{name} ms" for name in COLUMNS), "gain", "paper", "gain, leaps", "cells",
            "samples", "leaps", "coherence", "both", "in 10", "coherent", "differ", "same bits"]  # fmt: skip
    return "\n".join([
        f"Processor time per picture of {result['size']} by {result['size']}, {DEGREES:g} degrees apart."
        " gain: nothing / coherence; gain, leaps: leaps / both; cells: leaps / cells.",
        table(head, cells), *closing(result),
    ])  # fmt: skip


def draw(result: dict[str, Any], options: Options) -> list:
    return []
