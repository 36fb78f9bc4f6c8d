"""Writes a volume that changes over time, a file for each of 24 steps, and a scene of it.

    python data/examples/series.py out/series
    clvol info out/series/series.toml                            # the steps, and the range over all times
    clvol render out/series/series.toml -o out/series.webp       # a frame for each step; or -o 'out/s_%02d.png'
    clvol sheet out/series/series.toml --step ::4 -o out/sheet.png
"""

import sys
from pathlib import Path

import nrrd
import numpy as np

STEPS, SIZE = 24, 48
SCENE = """version = 1

[volume]
file = "t_*.nrrd"                 # in natural order: t_2 before t_10; or a list of names
# steps_per_second = 12.0         # by default the steps are spread over the frames, of which there is one for each
# loop = true                     # after the last step the first one; by default the last one stays
# step = 3                        # this step at all times
# value_range = [0.0, 255.0]      # saves reading every step once for the range over all times

[animation]
fps = 12.0

[camera]
view = "front-left"

[image]
width = 320
height = 320

[transfer_function]               # the same at all times
opacity_unit = 3.0
points = [
  { value = 20.0,  opacity = 0.0,  color = "midnightblue" },
  { value = 60.0,  opacity = 0.15, color = "steelblue" },
  { value = 120.0, opacity = 0.5,  color = "orange" },
  { value = 255.0, opacity = 0.9,  color = "white" },
]
"""


def step(k: int, steps: int = STEPS, size: int = SIZE) -> np.ndarray:
    """uint8 [z, y, x]: two drops that fall into each other and spread as one."""
    z, y, x = np.meshgrid(*[np.linspace(-1.0, 1.0, size)] * 3, indexing="ij")
    time = k / max(steps - 1, 1)
    apart, width = 0.7 * max(0.0, 1.0 - 1.6 * time), 0.18 + 0.25 * max(0.0, time - 0.4)
    drops = sum(np.exp(-((x - side * apart) ** 2 + y**2 + z**2) / (2 * width**2)) for side in (-1.0, 1.0))
    ripple = 1.0 + 0.25 * np.cos(24.0 * np.sqrt(x**2 + y**2 + z**2) - 12.0 * time)
    return np.clip(150.0 * drops * ripple * (0.18 / width), 0.0, 255.0).astype(np.uint8)


def main(folder: str, steps: int = STEPS, size: int = SIZE) -> Path:
    """Writes the steps and the scene, and returns the name of the scene."""
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    for k in range(steps):
        nrrd.write(str(place / f"t_{k}.nrrd"), step(k, steps, size), {"encoding": "gzip"}, index_order="C")
    scene = place / "series.toml"
    scene.write_text(SCENE, encoding="utf-8")
    return scene


if __name__ == "__main__":
    print(main(sys.argv[1] if len(sys.argv) > 1 else "out/series"))
