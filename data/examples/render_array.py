"""Renders a numpy array: voxels in, a float32 picture out.

Run: python data/examples/render_array.py [PICTURE.png [PIXELS]]
"""

import sys

import numpy as np

import clvol


def hydrogen(n: int = 96) -> np.ndarray:
    """float32 [z, y, x]: the density of an electron in a 3d orbital of hydrogen, 1 at its largest."""
    z, y, x = np.mgrid[-1:1:n * 1j, -1:1:n * 1j, -1:1:n * 1j] * 20
    r2 = x * x + y * y + z * z
    density = ((3 * y * y - r2) * np.exp(-np.sqrt(r2) / 3)) ** 2
    return (density / density.max()).astype(np.float32)


def main(path: str = "orbital.png", pixels: int = 480) -> clvol.Frame:
    volume = clvol.Volume(hydrogen(), spacing=(0.4, 0.4, 0.4))
    function = clvol.TransferFunction(
        values=[0.0, 0.01, 0.04, 0.2, 0.6],
        opacities=[0.0, 0.0, 0.15, 0.4, 0.9],
        colors=[[0.01, 0.08, 0.6], [0.01, 0.08, 0.6], [0.02, 0.4, 0.9], [1.0, 0.35, 0.02], [1.0, 0.9, 0.5]],
        opacity_unit=0.5,
    )
    scene = clvol.Scene(
        volume=volume,
        image=clvol.ImageSettings(width=pixels, height=pixels),
        transfer_function=function,
        light=[clvol.Light(type="headlight")],
        material=clvol.Material(ambient=0.5, diffuse=0.6),
    )
    with clvol.Renderer(scene) as renderer:
        frame = renderer.render()  # frame.rgba: float32 [height, width, 4], linear, premultiplied
    frame.save(path)
    print(f"{path}: {frame.stats['samples'] / 1e6:.2f} million samples in {frame.stats['seconds']['render']:.3f} s")
    return frame


if __name__ == "__main__":
    main(*sys.argv[1:2], *map(int, sys.argv[2:3]))
