"""Small scenes over analytic volumes."""

from __future__ import annotations

import numpy as np

from clvol import Camera, Scene, TransferFunction, Volume
from clvol.scene import ImageSettings, Integration

SMOOTH = TransferFunction(
    [0.0, 60.0, 140.0, 255.0],
    [0.0, 0.02, 0.10, 0.30],
    [[0.1, 0.2, 0.8], [0.2, 0.9, 0.4], [0.9, 0.6, 0.2], [1.0, 0.9, 0.9]],
)


def waves(shape, dtype=np.float32, low=0.0, high=255.0) -> np.ndarray:
    """A smooth field: products of a few low-frequency cosines, ``low`` .. ``high``."""
    z, y, x = (np.linspace(0.0, 1.0, n) for n in shape)
    field = (
        np.cos(5.0 * x[None, None, :] + 0.3)
        * np.cos(4.0 * y[None, :, None] - 0.5)
        * np.cos(3.0 * z[:, None, None] + 0.9)
    )
    field = (field - field.min()) / (field.max() - field.min())
    values = low + field * (high - low)
    return np.round(values).astype(dtype) if np.dtype(dtype).kind in "iu" else values.astype(dtype)


def make_scene(
    array=None, function=SMOOTH, *, camera=None, width=24, height=20, grid=None, **integration
):
    """A resolved scene; ``camera`` a dict of [camera], ``integration`` the keys of [integration]. Steps are even, as
    those of the numpy references, if nothing else is said."""
    if array is None:
        array = waves((19, 17, 23))
    volume = array if isinstance(array, Volume) else Volume(array, **(grid or {}))
    integration = {"early_termination": 0.0, "step_error": 0.0, **integration}
    return Scene(
        volume=volume,
        transfer_function=function,
        camera=None if camera is None else Camera(**camera),
        image=ImageSettings(width=width, height=height),
        integration=Integration(**integration),
    ).resolve()


def axis_camera(centre, axis=0, height=1.0, distance=40.0, sign=1, **keys) -> dict:
    """Orthographic, looking along an axis at ``centre`` [3]; ``sign`` 1: the way the axis points."""
    position = list(centre)
    position[axis] -= sign * distance
    up = [0.0, 0.0, 0.0]
    up[(axis + 2) % 3] = 1.0
    return {"projection": "orthographic", "position": position, "target": list(centre),
            "up": up, "height": height, **keys}  # fmt: skip


def picture(context, resolved, **how):
    """``FrameData`` of the ray caster; ``how``: the camera, or keys of ``Raycaster``."""
    from clvol.integrators.raycast.caster import Raycaster

    camera = how.pop("camera", resolved.camera)
    caster = Raycaster(context, resolved, **how)
    return caster.render(camera, resolved.image.width, resolved.image.height)


def exact(device, resolved, tolerance=1e-9) -> np.ndarray:
    """The reference's picture."""
    from clvol.integrators.reference.picture import render_reference

    return render_reference(resolved, device, tolerance=tolerance)[0]


def rms(a, b) -> float:
    return float(np.sqrt(np.mean((np.asarray(a, np.float64) - np.asarray(b, np.float64)) ** 2)))
