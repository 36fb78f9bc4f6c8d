"""Writes studio.exr beside itself: an environment map of a photographer's studio, 128 x 64 texels
by latitude and longitude (row 0: up; the middle column: -z), half floats.

A key light high on the right, a large weak one on the left, a strip behind, a dark floor and a sky
that brightens towards the zenith; linear radiance, the walls about 0.3, the key light 12.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

HEIGHT, WIDTH = 64, 128
# Azimuth (0: -z, 90: +x) and elevation of the centre, width and height, all degrees; radiance.
SOFT_BOXES = [
    (60.0, 45.0, 40.0, 30.0, (12.0, 11.0, 9.5)),
    (-75.0, 15.0, 60.0, 50.0, (1.6, 1.8, 2.2)),
    (170.0, 20.0, 16.0, 60.0, (5.0, 5.0, 5.5)),
]


def smooth_step(x: np.ndarray) -> np.ndarray:
    """0 below 0, 1 above 1, with a continuous slope."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def studio() -> np.ndarray:
    """float64 [64, 128, 3]."""
    elevation = 90.0 - (np.arange(HEIGHT) + 0.5)[:, None] * (180.0 / HEIGHT)
    azimuth = (np.arange(WIDTH) + 0.5)[None, :] * (360.0 / WIDTH) - 180.0
    up = smooth_step(elevation / 90.0)[..., None]
    wall = (1.0 - up) * np.array([0.25, 0.26, 0.28]) + up * np.array([0.7, 0.75, 0.85])
    floor = np.array([0.10, 0.09, 0.08])
    above = smooth_step((elevation + 12.0) / 12.0)[..., None]
    image = np.broadcast_to(floor + above * (wall - floor), (HEIGHT, WIDTH, 3)).copy()
    for centre, height, across, tall, radiance in SOFT_BOXES:
        turn = (azimuth - centre + 180.0) % 360.0 - 180.0
        beside = np.abs(turn) * np.cos(np.radians(height)) - 0.5 * across
        beyond = np.abs(elevation - height) - 0.5 * tall
        # Soft edges, 6 degrees wide.
        cover = smooth_step(0.5 - np.maximum(beside, beyond) / 6.0)[..., None]
        image += cover * (np.array(radiance) - image)
    return image


if __name__ == "__main__":
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    pixels = np.ascontiguousarray(studio(), np.float16)
    path = Path(__file__).with_name("studio.exr")
    OpenEXR.File(header, {"RGB": pixels}).write(str(path))
