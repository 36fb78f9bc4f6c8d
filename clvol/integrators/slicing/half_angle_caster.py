"""Half-angle slices of a volume that is on the device as a whole: the sweep of the light (cl/light_slices.cl), and the
picture of what it lights (cl/march_half_angle.h)."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from clvol.device.arguments import EFFECT_ARGUMENTS, Arguments, scene_arguments
from clvol.device.light_volume import CONE_DIRECTIONS, METHODS, cone_directions
from clvol.errors import RenderError
from clvol.features import SLICES
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.march import RayMarch
from clvol.integrators.slicing.half_angle import (
    HalfAnglePlan,
    half_angle_plan,
    half_angle_row,
    light_texels,
    shadowing_light,
)
from clvol.opencl.arguments import reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.opencl.structs import HALF_ANGLE
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.schedule.tiles import bands

_SECONDS_A_SAMPLE, _BAND_SECONDS = 1e-8, 0.5
_WORK_GROUP = 64
_TOGETHER = 16  # texels that lie together (cl/slice_light.h)
_MOST_FLOATS = 2**31 - 1  # which an int of the kernel numbers
_HALF_ANGLE = (reads("half_angle", HALF_ANGLE),)
_ARGUMENTS = (
    reads("cone", np.float32, 1 + CONE_DIRECTIONS, 4),
    value("begin", np.int32),
    value("end", np.int32),
    value("first", np.int32),
    reads("before", np.float32, "texels", "channels"),
    writes("after", np.float32, "texels", "channels"),
    writes("lit", np.float32, "slabs", "texels", "channels"),
    writes("samples", np.uint32, "items"),
)


class HalfAngleMarch(RayMarch):
    """A ``March`` through the slabs of ``plan``, which depend on the camera and are lit before each picture."""

    varies_steps = False

    def __init__(self) -> None:
        self.plan: HalfAnglePlan | None = None
        self.row = np.zeros(1, HALF_ANGLE)
        self.light_samples = 0  # reconstructions of the volume for the light of the picture
        self._lit: DeviceArray | None = None

    def switches(self) -> dict[str, int]:
        return half_angle_switches()

    def for_scene(self, caster: Raycaster, before: Raycaster) -> HalfAngleMarch:
        return copy.copy(self)

    def begin(self, caster: Raycaster, camera: Camera | None, width: int, height: int) -> None:
        resolved = caster.resolved
        self.light_samples = 0
        self.plan = None if camera is None else half_angle_plan(resolved, camera, caster.volume.size)
        light = shadowing_light(resolved)
        casts = caster.switches.get("SHADOWS") == METHODS["half-angle"]
        if self.plan is not None:
            texels = None if light is None else light_texels(resolved, light)
            self.row = half_angle_row(resolved, self.plan, texels)
        if casts and light is not None:
            self._light_slabs(caster, light_texels(resolved, light))

    def _light_slabs(self, caster: Raycaster, texels: Any) -> None:
        """Sets the caster's light volume to the share of the light in each slab. Without a plan the kernel is only
        compiled."""
        context, switches = caster.context, {**caster.switches, "WITH_DEPTH": 0}
        slabs = 0 if self.plan is None else self.plan.count
        pixels, lanes = texels.width * texels.height, switches["LANES"]
        channels = 4 if switches["SCATTERING"] else 1
        needed = max(slabs, 1) * (-(-pixels // _TOGETHER) * _TOGETHER) * channels
        if needed > _MOST_FLOATS:
            what = f"{needed} numbers of light in {slabs} slices"
            raise RenderError(f"{caster.resolved.origin}: shadow.resolution", what, f"at most {_MOST_FLOATS}")
        if self._lit is None or self._lit.shape[0] < needed:
            self._lit = context.empty(np.float32, (needed,))
        caster.effects.arrays["light_volume"] = self._lit
        items, group = -(-pixels // lanes), 1 if lanes > 1 else _WORK_GROUP
        view = caster.frame_view(texels.frame, texels.width, texels.height)
        first_state = np.zeros((pixels, channels), np.float32)
        first_state[:, 1:] = 1.0
        carried = [context.upload(first_state), context.empty(np.float32, first_state.shape)]
        counts = context.upload(np.zeros(items, np.uint32), writable=True)
        declared = scene_arguments(switches["VOXEL_BITS"]) + EFFECT_ARGUMENTS + _HALF_ANGLE + _ARGUMENTS
        kernel = context.kernel("light_slices.cl", "light_slices", declared, switches)
        given = {
            **caster._scene_arrays(), **caster.effects.arrays, "view": context.upload(view),
            "half_angle": context.upload(self.row), "cone": context.upload(_cone(caster.resolved)),
        }  # fmt: skip
        sizes = {"texels": pixels, "channels": channels, "slabs": slabs, "items": items}
        launched = slabs if channels == 1 else 1  # at once: scattered light comes from neighbours
        for begin in range(0, max(slabs, 1), max(launched, 1)):
            end = min(begin + launched, slabs)
            for first, count in bands(items, pixels * (end - begin) * _SECONDS_A_SAMPLE, _BAND_SECONDS):
                kernel(
                    context.queue, (-(-count // group) * group,), (group,), sizes=sizes, begin=begin, end=end,
                    first=first * lanes, before=carried[0], after=carried[1], lit=self._lit, samples=counts, **given,
                )  # fmt: skip
            carried.reverse()
        self.light_samples = int(context.read(counts).sum(dtype=np.uint64))

    def take_light_samples(self) -> int:
        """``light_samples``, once per picture."""
        taken, self.light_samples = self.light_samples, 0
        return taken


class HalfAngleCaster(Raycaster):
    """A ``Raycaster`` with a ``HalfAngleMarch``. Neither the light nor the eye samples what is transparent."""

    march: HalfAngleMarch

    def __init__(self, context: DeviceContext, resolved: ResolvedScene, **more: Any) -> None:
        super().__init__(context, resolved, march=HalfAngleMarch(), **more)

    @property
    def structs(self) -> dict[str, np.dtype]:
        return {**super().structs, "HalfAngle": HALF_ANGLE}

    @property
    def _sample_arguments(self) -> tuple[Arguments, dict[str, DeviceArray]]:
        arrays = {**self.effects.arrays, "half_angle": self.context.upload(self.march.row)}
        return EFFECT_ARGUMENTS + _HALF_ANGLE, arrays

    def counted(self, counts: np.ndarray) -> dict[str, int]:
        named = super().counted(counts)
        if self.switches.get("SHADOWS") == METHODS["half-angle"]:
            named["shadow_samples"] = self.march.take_light_samples()
        return named


def half_angle_switches() -> dict[str, int]:
    """The switches (-D) of cl/march_half_angle.h, without those of samples and effects. Slabs are not all as long as a
    step."""
    return {"SLICES": SLICES["half-angle"], "SEGMENT_OPACITIES": 0}


def _cone(resolved: ResolvedScene) -> np.ndarray:
    shadow = resolved.shadow
    if shadow is None:
        raise ValueError("the scene has no [shadow] table")
    cone = np.zeros((1 + CONE_DIRECTIONS, 4), np.float32)
    cone[0] = (*(1.0 - np.asarray(shadow.scatter_color)), CONE_DIRECTIONS)
    cone[1:, :3] = cone_directions(shadow.cone_degrees)
    return cone
