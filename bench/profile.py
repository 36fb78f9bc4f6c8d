"""Where the time of a frame goes, by the lines of the kernels at which a profiler finds the processor.

Linux's ``perf`` samples a process that renders one picture after the other; PoCL keeps the lines of the source with its
code (``-g``), so that each sample belongs to a chain of lines that were inlined into each other. What belongs to no
kernel (Python, PoCL's scheduling, the system) is the rest of the frame's processor time.

Beside it, the floor: the gathers that the frame's samples need, from the L1 cache, at what ``bench sampling`` measures.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from bench.options import Options
from bench.report import closing, load_average, opening, say, table
from bench.scenes import SCENES, BenchScene
from clvol.errors import ClvolError, RenderError

SUMMARY = "where the processor time of a frame goes, as a stacked picture (needs perf, addr2line and PoCL)"
RATE = 1999  # samples per second of processor time
_ROOT = Path(__file__).resolve().parent.parent
# What a file of cl/ is part of.
PARTS: dict[str, tuple[str, ...]] = {
    "leaping over empty space": ("skip_empty.h", "coherence.h"),
    "spans of packets": ("packet_spans.h",),
    "rays": ("rays.h", "view.h", "along_rays.h"),
    "voxels: gathers": (),  # the lines of lanes.h that gather, unless they leap
    "voxels: addresses and interpolation": ("sample_volume.h", "fetch_voxel.h", "voxel_type.h"),
    "classification": (
        "classify.h", "transfer_pieces.h", "stretch.h", "segment_queue.h", "opacity.h", "shows_between.h", "power.h",
    ),
    "compositing, and the march itself": ("composite.h", "march.h", "march_plain.h", "march_steps.h", "owned_box.h"),
}  # fmt: skip
_GATHERS = "voxels: gathers"
STORING, REST = "storing pixels", "outside of kernels"
NAMES = (*PARTS, STORING, REST)


def run(options: Options) -> dict[str, Any] | None:
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    missing = [tool for tool in ("perf", "addr2line") if shutil.which(tool) is None]
    if missing or not device.platform.name.startswith("Portable"):
        say(f"left out: {' and '.join(missing) or 'a device of PoCL'} is needed")
        return None
    size, frames = (64, 20) if options.quick else (512, 200)
    start = time.perf_counter()
    result = opening(device, options.quick, size) | {"scenes": []}
    for scene in SCENES:
        if options.scenes and scene.name not in options.scenes:
            continue
        if not scene.path().is_file():
            result["missing"].append(scene.file)
            continue
        try:
            found = _profile(scene, size, frames, device.name)
        except ClvolError as error:
            say(f"{scene.name}: {error}")
            return None
        say(f"{scene.name}: {1e3 * found['seconds']:.1f} ms of processor time per frame")
        result["scenes"].append(found)
    result |= {"seconds": time.perf_counter() - start, "load_after": load_average()}
    return result if result["scenes"] else None


def _profile(scene: BenchScene, size: int, frames: int, device: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="clvol-profile-") as folder:
        data = os.path.join(folder, "perf.data")
        words = [sys.executable, "-m", "bench.profile_child", scene.name, str(size), str(frames), device, folder]
        # Caches of its own, since programs are compiled with another option.
        environment = os.environ | {"POCL_EXTRA_BUILD_FLAGS": "-g", "XDG_CACHE_HOME": folder, "TMPDIR": folder}
        printed = _output(["perf", "record", "-q", "-e", "cpu-clock", "-F", str(RATE), "-o", data, *words], environment)
        child = json.loads(printed.splitlines()[-1])
        code = os.path.join(folder, "raycast.so")
        if not os.path.exists(code):
            raise RenderError("profile", "PoCL has left no code of its kernel to look at")
        # perf may not read what PoCL has removed meanwhile, so that its addresses are looked up in the copy.
        hits: Counter[int] = Counter()
        for line in _output(["perf", "script", "-i", data, "-F", "ip,dso"]).splitlines():
            words = line.split()
            if words and "raycast.so" in line:
                hits[int(words[0], 16) - child["begins"] + child["offset"]] += 1
        parts = shares(hits, places(code, hits))
    seconds = {part: count / RATE / child["frames"] for part, count in parts.items()}
    return {
        "scene": scene.name, "classification": child["classification"], "samples": child["samples"],
        "seconds": child["seconds"], "profiled": sum(parts.values()),
        "parts": {**seconds, REST: max(child["seconds"] - sum(seconds.values()), 0.0)},
    }  # fmt: skip


def places(code: str, addresses: Iterable[int]) -> dict[int, list[str]]:
    """ "FILE:LINE" of each address, of the innermost function first, as the file ``code`` says."""
    wanted = [hex(address) for address in addresses]
    found: dict[int, list[str]] = {}
    for first in range(0, len(wanted), 1000):
        words = ["addr2line", "-e", code, "-i", "-a", *wanted[first : first + 1000]]
        lines: list[str] = []
        for line in _output(words).splitlines():
            if line.startswith("0x"):
                lines = found[int(line, 16)] = []
            else:
                lines.append(os.path.basename(line.split(" ")[0]))
    return found


def shares(hits: Counter[int], lines: dict[int, list[str]]) -> Counter[str]:
    """Samples of each part: by the innermost file that belongs to one. Files of lanes and vectors serve all parts; what
    only they know gathers, if it is on such a line, and belongs to the march otherwise."""
    part_of = {file: part for part, files in PARTS.items() for file in files}
    gathers = {
        f"lanes.h:{number}"
        for number, line in enumerate((_ROOT / "cl" / "lanes.h").read_text(encoding="utf-8").splitlines(), 1)
        if line.startswith("DEFINE_GATHER")
    }
    found: Counter[str] = Counter(dict.fromkeys((*PARTS, STORING), 0))
    for address, count in hits.items():
        chain = lines.get(address, [])
        known = [part_of[file] for file in (line.partition(":")[0] for line in chain) if file in part_of]
        part = known[0] if known else "compositing, and the march itself"
        if not chain or chain[-1].startswith("?"):
            part = STORING  # the kernel's own function, of which PoCL keeps no lines
        elif gathers.intersection(chain) and part not in ("leaping over empty space", "spans of packets"):
            part = _GATHERS
        found[part] += count
    return found


def _output(words: list[str], environment: dict[str, str] | None = None) -> str:
    done = subprocess.run(words, capture_output=True, text=True, cwd=_ROOT, env=environment)
    if done.returncode != 0:
        said = (done.stderr.strip() or f"status {done.returncode}").splitlines()
        raise RenderError(words[0], f"{' '.join(words[1:3])} failed: {said[-1]}")
    return done.stdout


def show(result: dict[str, Any]) -> str:
    head = ["ms of processor time per frame", *(s["scene"] for s in result["scenes"])]
    rows = [
        [part, *(f"{1e3 * s['parts'][part]:.2f}" for s in result["scenes"])] for part in NAMES
    ]  # fmt: skip
    rows.append(["all", *(f"{1e3 * s['seconds']:.2f}" for s in result["scenes"])])
    rows.append(["million samples", *(f"{s['samples'] / 1e6:.2f}" for s in result["scenes"])])
    rows.append(["classification", *(s["classification"] for s in result["scenes"])])
    size = result["size"]
    return "\n".join([f"{size} x {size} pixels, step 1, default settings", table(head, rows), *closing(result)])


def draw(result: dict[str, Any], options: Options) -> list[Path]:
    from bench.charts import stack_chart

    return [stack_chart(result, NAMES, options.folder / "profile.png")]
