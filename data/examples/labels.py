"""Writes labels.nrrd: four regions of the head in brainsmall.nrrd, by position, on a grid four times as coarse.

They are wedges about the middle of the brain, for the example of a second volume; they are not anatomy.
Run: python data/examples/labels.py
"""

from pathlib import Path

import nrrd
import numpy as np

SHAPE, SPACING = (21, 32, 32), 4.0  # [z, y, x]
MIDDLE = (72.0, 50.0)  # x, y of the middle of the brain in voxels of brainsmall.nrrd


def labels() -> np.ndarray:
    """uint8 [z, y, x]: 1 to 4 by the angle about the middle."""
    y, x = np.mgrid[: SHAPE[1], : SHAPE[2]] * SPACING
    angle = np.degrees(np.arctan2(y - MIDDLE[1], x - MIDDLE[0]))
    wedge = 1 + np.searchsorted([-120.0, -60.0, 10.0], angle.ravel()).reshape(angle.shape)
    wedge[(angle > 75) | (y > 92)] = 0  # the face and the neck keep their own colour
    return np.broadcast_to(wedge.astype(np.uint8), SHAPE)


if __name__ == "__main__":
    header = {
        "space": "left-posterior-superior",
        "space directions": np.diag([SPACING] * 3),
        "space origin": np.zeros(3),
        "encoding": "gzip",
    }
    path = Path(__file__).with_name("labels.nrrd")
    nrrd.write(str(path), np.ascontiguousarray(labels().T), header)
