"""Renders to an error: clvol chooses the cheapest settings whose RMSE against the exact integral stays below it.

The same from the command line: clvol render SCENE -o PICTURE --max-error 1e-3
Run: python data/examples/render_to_error.py [PICTURE.png [PIXELS [MAX_ERROR]]]
"""

import sys
from pathlib import Path

import clvol

SCENE = Path(__file__).with_name("transfer_function.toml")


def main(path: str = "to_error.png", pixels: int = 480, max_error: float = 1e-3) -> clvol.Frame:
    scene = clvol.load_scene(SCENE, [f"image.width={pixels}", f"image.height={pixels}"])
    frame = clvol.render_to_error(scene, max_error)
    frame.save(path)
    measured = frame.stats["accuracy"]
    print(f"{path}: RMSE {measured['rmse']:.2e}, at most {measured['bound']:.2e} ({measured['confidence']:.1%} sure)")
    for key, value in measured["settings"].items():
        print(f"  {key} = {value}")
    return frame


if __name__ == "__main__":
    main(*sys.argv[1:2], *map(int, sys.argv[2:3]), *map(float, sys.argv[3:4]))
