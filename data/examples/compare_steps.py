"""Compares settings: the error of a picture against the exact integral, and its time, for one step after the other.

`clvol tradeoff SCENE -o DIR` does this for all settings at once, with a report; `clvol compare A B` for two files.
Run: python data/examples/compare_steps.py [PIXELS]
"""

import sys
from pathlib import Path

import clvol
from clvol.accuracy.metrics import compare

SCENE = Path(__file__).with_name("transfer_function.toml")


def main(pixels: int = 240) -> list[tuple[float, float, float]]:
    """(step, RMSE, CIEDE2000) of each picture."""
    scene = clvol.load_scene(SCENE, [f"image.width={pixels}", f"image.height={pixels}"])
    exact = render(scene, clvol.Integration(method="reference", tolerance=1e-6))
    rows = []
    print("  step      RMSE  CIEDE2000  seconds")
    for step in (4.0, 2.0, 1.0, 0.5, 0.25):
        frame = render(scene, clvol.Integration(step=step, early_termination=0.0))
        error = compare(frame.rgba, exact.rgba)
        rows.append((step, error["rmse"], error["delta_e_mean"]))
        print(f"{step:6g}  {error['rmse']:.2e}  {error['delta_e_mean']:9.3f}  {frame.stats['seconds']['render']:7.4f}")
    return rows


def render(scene: clvol.Scene, integration: clvol.Integration) -> clvol.Frame:
    with clvol.Renderer(scene.model_copy(update={"integration": integration})) as renderer:
        return renderer.render()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
