"""A process that ``bench profile`` watches: pictures of a scene, one after the other.

    python -m bench.profile_child SCENE SIZE FRAMES DEVICE FOLDER

Prints, as JSON, the processor seconds of a frame, its samples, and where the kernel's code lies; keeps a copy of that
code in FOLDER.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path


def main(arguments: list[str]) -> None:
    from bench.scenes import SCENES
    from clvol import Renderer
    from clvol.opencl.devices import open_device

    name, size, frames, device, folder = arguments
    (scene,) = (each for each in SCENES if each.name == name)
    with Renderer(scene.scene(scene.load(), int(size)), devices=[open_device(device)]) as renderer:
        for _ in range(2):
            renderer.render(depth=False)
        start = os.times()
        for _ in range(int(frames)):
            frame = renderer.render(depth=False)
        end = os.times()
        found = {
            "seconds": (end.user + end.system - start.user - start.system) / int(frames),
            "samples": frame.stats["samples"], "frames": 2 + int(frames),
            "classification": frame.stats["classification"]["name"],
        }  # fmt: skip
        for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
            if "r-xp" in line and line.endswith("/raycast.so"):
                addresses, _, offset, *_, path = line.split()
                found |= {"begins": int(addresses.split("-")[0], 16), "offset": int(offset, 16)}
                shutil.copy(path, os.path.join(folder, "raycast.so"))
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1:])
