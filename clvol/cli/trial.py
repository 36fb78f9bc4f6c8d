"""Renders a small picture on one device in a child process, in the same way as ``clvol render``.

The probe of the devices tests only the minimum. Rendering also needs all kernels, a compiler that can build them, and
folders for programs and temporary files. ``clvol doctor`` reports a device as working only if it rendered a picture
and the picture was correct.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

TIME_LIMIT = 600.0  # seconds; on a busy machine compilers take minutes if nothing is cached
_MARK = "clvol-trial: "
_EDGE, _OPACITY, _VALUE = 8, 0.1, 100
_FRAMES = 9  # of the measurement


@dataclass(frozen=True)
class Trial:
    """The result of a trial. ``reason``: one line on what went wrong, "" if the picture was correct. ``notices``: other
    problems of the machine, by the place where they occur. ``speed``: samples of a smooth volume per second, with
    the default settings; 0 if it is not known."""

    reason: str = ""
    notices: dict[str, str] = field(default_factory=dict)
    speed: float = 0.0


def try_render(name: str, time_limit: float = TIME_LIMIT) -> Trial:
    """Renders a small picture on the device called ``name`` in a child process, and checks it."""
    from clvol.opencl.children import child_command, child_environment, end_child
    from clvol.opencl.folders import scratch_folder
    from clvol.opencl.probe import first_meaningful_line

    command = child_command(__file__, name)
    with tempfile.TemporaryFile(dir=scratch_folder()) as stderr:
        try:
            process = subprocess.Popen(
                command, env=child_environment(), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=stderr, start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            return Trial(f"{command[0]} cannot be started: {error.strerror}")
        try:
            out, _ = process.communicate(timeout=time_limit)
        except subprocess.TimeoutExpired:
            return Trial(f"rendering: no picture within {time_limit:g} s")
        finally:
            end_child(process)
        for line in out.decode("utf-8", errors="replace").splitlines():
            if line.startswith(_MARK):
                answer = json.loads(line.removeprefix(_MARK))
                return Trial(answer["reason"], answer["notices"], float(answer["speed"]))
        stderr.seek(0)
        message = first_meaningful_line(stderr.read()[-20000:].decode("utf-8", errors="replace"))
    status = process.returncode
    try:
        how = f"crashed ({signal.Signals(-status).name})" if status < 0 else f"ended with status {status}"
    except ValueError:
        how = f"crashed (signal {-status})"
    return Trial(f"rendering {how}: {message}" if message else f"rendering {how}")


def _render(name: str) -> str:
    """Renders a box of constant value, and says what is wrong with the picture; "" if it is correct."""
    import numpy as np

    from clvol import Renderer, Scene, Volume

    voxels = np.full((_EDGE, _EDGE, _EDGE), _VALUE, np.uint8)
    point = {"opacity": _OPACITY, "color": [1.0, 0.5, 0.25]}
    scene = Scene(
        volume=Volume(voxels),
        camera={"projection": "orthographic", "height": 4.0, "position": [3.5, 3.5, 20.0],
                "target": [3.5, 3.5, 3.5], "up": [0.0, 1.0, 0.0]},
        image={"width": 32, "height": 32},
        transfer_function={"color_space": "linear", "points": [{"value": 0.0, **point}, {"value": 255.0, **point}]},
        integration={"early_termination": 0.0},
    )  # fmt: skip
    with Renderer(scene, devices=[name]) as renderer:
        rgba = renderer.render().rgba
    off = float(np.abs(rgba - _expected()).max())
    return "" if off < 1e-4 else f"rendering: the picture is wrong by {off:.3g}"


def _speed(name: str) -> float:
    """Samples per second: the best of some frames of a smooth, slightly opaque volume, since other programs only slow
    frames down."""
    from clvol import Renderer, Scene

    points = [
        {"value": 0.0, "opacity": 0.0, "color": [1.0, 0.5, 0.2]},
        {"value": 255.0, "opacity": 0.02, "color": [0.2, 0.5, 1.0]},
    ]
    scene = Scene(
        volume={"field": "ellipsoid", "size": [96, 96, 96]}, image={"width": 256, "height": 256},
        transfer_function={"points": points},
    )  # fmt: skip
    with Renderer(scene, devices=[name]) as renderer:
        frames = [renderer.render(depth=False) for _ in range(_FRAMES + 1)][1:]
    return max(frame.stats["samples"] / frame.stats["seconds"]["render"] for frame in frames)


def _expected() -> np.ndarray:
    """The RGBA of every pixel; the depth of the box is the distance of its outermost voxel centres."""
    import numpy as np

    alpha = 1.0 - (1.0 - _OPACITY) ** (_EDGE - 1)
    return np.array([1.0, 0.5, 0.25, 1.0]) * alpha


def main(name: str) -> None:
    import warnings

    from clvol.errors import ClvolError
    from clvol.opencl import notices

    # Drivers print to standard output, so the answer is written to a descriptor of its own.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    warnings.simplefilter("ignore")
    speed = 0.0
    try:
        reason = _render(name)
        if not reason:
            speed = _speed(name)
    except ClvolError as error:
        reason = f"rendering: {error}"
    except Exception as error:
        reason = f"rendering: {type(error).__name__}: {error}"
    answer = {"reason": " ".join(reason.split()), "notices": notices.told(), "speed": speed}
    answers.write(_MARK + json.dumps(answer) + "\n")
    answers.flush()


if __name__ == "__main__":
    from clvol.cli.ending import leave

    main(sys.argv[1])
    leave(0)
