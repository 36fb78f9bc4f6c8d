"""Small scenes with effects: pictures by kernels and by the twin, and how far apart they may be."""

from __future__ import annotations

import numpy as np
from reference import render_twin

from clvol import Scene, TransferFunction, Volume

LIGHTS = (
    {"type": "directional", "direction": [-1.0, -2.0, -0.7], "color": [1.0, 0.9, 0.6]},
    {"type": "point", "position": [30.0, -8.0, 14.0], "intensity": 0.7},
    {"type": "headlight", "color": [0.3, 0.4, 0.5]},
)
MATERIAL = {"ambient": 0.12, "diffuse": 0.6, "specular": 0.35, "shininess": 14.0}
HAZE = TransferFunction(
    [0.0, 0.3, 0.55, 1.0],
    [0.0, 0.04, 0.16, 0.35],
    [[0.1, 0.2, 0.8], [0.2, 0.9, 0.4], [0.9, 0.6, 0.2], [1.0, 0.9, 0.9]],
)
NOTHING = TransferFunction([0.0], [0.0], [[0.0, 0.0, 0.0]])
SIZE = (27, 21)  # no multiple of a packet or a tile


def blobs(shape=(15, 17, 19), seed=3, top=1.0, dtype=np.float32) -> np.ndarray:
    """[z, y, x], 0 .. ``top``: a few Gaussians, smooth over two voxels."""
    rng = np.random.default_rng(seed)
    z, y, x = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    field = np.zeros(shape)
    for _ in range(9):
        centre, width = rng.uniform(0, 1, 3) * np.array(shape), rng.uniform(2.0, 4.5)
        square = (z - centre[0]) ** 2 + (y - centre[1]) ** 2 + (x - centre[2]) ** 2
        field += rng.uniform(0.4, 1.0) * np.exp(-square / (2 * width**2))
    field = top * (field - field.min()) / (field.max() - field.min())
    return np.round(field).astype(dtype) if np.dtype(dtype).kind in "iu" else field.astype(dtype)


def ball(shape=(17, 17, 17), centre=None) -> np.ndarray:
    """float32 [z, y, x]: the distance from ``centre`` (x, y, z), of the middle if left out."""
    centre = [(n - 1) / 2 for n in shape[::-1]] if centre is None else centre
    z, y, x = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    square = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2
    return np.sqrt(square).astype(np.float32)


def scaled(function: TransferFunction, factor: float, unit: float = 1.0) -> TransferFunction:
    """The same over values and lengths that many times as large."""
    return TransferFunction(
        factor * function.values, function.opacities, function.colors, unit * function.opacity_unit
    )


def scene(array, function=HAZE, *, grid=None, size=SIZE, **tables):
    """A resolved scene; ``tables`` as in a scene file."""
    volume = array if isinstance(array, Volume) else Volume(array, **(grid or {}))
    integration = {"early_termination": 0.0, "table_size": 512, "classification": "post"}
    integration.update(tables.pop("integration", {}))
    return Scene(
        volume=volume,
        transfer_function=function,
        integration=integration,
        image={"width": size[0], "height": size[1]},
        **tables,
    ).resolve()


def oblique(shape, spacing=(1.0, 1.0, 1.0), *, away=2.2, **keys) -> dict:
    """A perspective [camera] on a volume of ``shape`` [z, y, x], along no axis or diagonal."""
    size = (np.array(shape[::-1]) - 1.0) * spacing
    length = max(np.linalg.norm(size), 1.0)
    position = size / 2 + away * length * np.array([0.53, 0.37, -0.76])
    camera = {"position": position.tolist(), "target": (size / 2).tolist(), "up": [0.1, 1.0, 0.2],
              "fov_degrees": float(2 * np.degrees(np.arctan(0.42 / away)))}  # fmt: skip
    return {**camera, **keys}


def picture(context, resolved, **how):
    """``FrameData`` of the ray caster; ``how``: keys of ``Raycaster``."""
    from clvol.device.prefilter import prefiltered
    from clvol.integrators.raycast.caster import Raycaster

    caster = Raycaster(context, prefiltered(resolved), **how)
    return caster.render(resolved.camera, resolved.image.width, resolved.image.height)


_twins: dict = {}


def twin(resolved) -> np.ndarray:
    """The twin's picture; once for all devices."""
    key = resolved.source, resolved.volume.data.tobytes()
    if key not in _twins:
        _twins[key] = render_twin(resolved)
    return _twins[key]
