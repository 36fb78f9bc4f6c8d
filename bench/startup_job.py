"""A job in a process of its own: processor time per picture, beside that of the same frames alone.

    python -m bench.startup_job FOLDER camera|function SIZE COUNT DEVICE

Prints JSON: ``picture`` and ``frame``, medians in seconds of a processor, and on the clock (``wall``).
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from pathlib import Path
from statistics import median

_DEMO = Path(__file__).resolve().parent.parent / "data" / "demo.toml"
_SETTLED = 5  # pictures that are not counted: they compile, and allocate what later ones use again


def job_text(folder: Path, varied: str, size: int, count: int) -> str:
    """A job of ``count`` pictures of the demo: from cameras around it, or with other opacity units."""
    if varied == "camera":
        turns = [0.1 * k for k in range(count)]
        values: list = [[66 - 260 * math.sin(turn), -70.0, 41.5 - 260 * math.cos(turn)] for turn in turns]
    else:
        values = [0.5 + 0.01 * k for k in range(count)]
    key = {"camera": "camera.position", "function": "transfer_function.opacity_unit"}[varied]
    return (
        f"scenes = [{json.dumps(str(_DEMO))}]\noutput = {json.dumps(str(folder / '{number:04d}.png'))}\n"
        f'[set]\n"image.width" = {size}\n"image.height" = {size}\n'
        f'[[vary]]\nkey = "{key}"\nvalues = {values!r}\n'
    )


def _now() -> tuple[float, float]:
    """Seconds of a processor, and on the clock."""
    return time.process_time(), time.perf_counter()


def main(folder: str, varied: str, size: str, count: str, device: str = "") -> None:
    from clvol.batch.job import load_job, pictures_of
    from clvol.batch.run import JobRun, Options
    from clvol.render import Renderer
    from clvol.scene import load_scene

    place = Path(folder, f"{varied}-{size}")
    place.mkdir()
    job = place / "job.toml"
    job.write_text(job_text(place, varied, int(size), int(count)), encoding="utf-8")
    pictures = pictures_of(load_job(job), job)
    devices = [device] if device else None
    done: list[tuple[float, float]] = []
    outcome = JobRun(
        pictures, Options(devices=devices, results=str(place / "results.jsonl")),
        lambda result: done.append(_now()),
    ).run()  # fmt: skip
    assert outcome.counts["rendered"] == len(pictures), outcome
    frames = []
    with Renderer(load_scene(pictures[0].source, settings=pictures[0].settings), devices) as renderer:
        for picture in pictures:
            scene = load_scene(picture.source, settings=picture.settings)
            if varied == "camera":
                begun = _now()
                renderer.render(camera=scene.camera, depth=False)
            else:
                renderer.set_transfer_function(scene.resolve().transfer_function)
                begun = _now()
                renderer.render(depth=False)
            frames.append([b - a for a, b in zip(begun, _now())])
    between = [[b - a for a, b in zip(*two)] for two in zip(done[_SETTLED:], done[_SETTLED + 1 :])]
    (picture, picture_wall), (frame, frame_wall) = (map(median, zip(*each)) for each in (between, frames[_SETTLED:]))
    result = {
        "varied": varied, "size": int(size), "pictures": len(pictures), "picture": picture, "frame": frame,
        "wall": {"picture": picture_wall, "frame": frame_wall},
    }  # fmt: skip
    print(json.dumps(result), flush=True)
    os._exit(0)  # drivers may crash while they are unloaded


if __name__ == "__main__":
    main(*sys.argv[1:])
