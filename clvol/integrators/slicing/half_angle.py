"""Where half-angle slices lie, and how their texels see the volume: arithmetic, without a device (cl/half_angle.h)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.device.light_volume import casting_lights, slab_count
from clvol.device.local_space import LocalSpace, unit_vector
from clvol.device.view import RayFrame, ray_frame
from clvol.errors import RenderError, SceneError
from clvol.opencl.structs import HALF_ANGLE
from clvol.scene.camera import Camera
from clvol.scene.light import Light
from clvol.scene.resolve import ResolvedScene
from clvol.scene.slicing import MOST_SLICES
from clvol.volume import Grid

WIDEST = 42.0  # degrees between the middle of a light and its outermost rays: slabs are met at 45 or less
_OWN_SHARES = {"middle": 0.5, "front": 0.0}
_FAR = 1e6  # in radii of the volume: light from farther away has one direction


@dataclass(frozen=True, eq=False)
class HalfAnglePlan:
    """The slabs of a picture. ``across`` float64 [4]: the number of a lattice point's slab, before it is rounded down,
    is across . (x, y, z, 1). ``normal``: unit vector in the world, along which light goes through the slabs.
    ``towards_eye``: whether light comes towards the eye. ``spacing``: of slabs, in smallest edges."""

    normal: np.ndarray
    across: np.ndarray
    count: int
    spacing: float
    towards_eye: bool


@dataclass(frozen=True, eq=False)
class LightTexels:
    """The texels of a light: the pixels of its ``camera``, ``width`` by ``height``. ``rows`` float64 [3, 4]: a lattice
    point (x, y, z, 1) to column w, row w and w. ``per_edge``: texels per edge across the light; of a light at a point
    at the distance of one edge."""

    camera: Camera
    frame: RayFrame
    width: int
    height: int
    rows: np.ndarray
    per_edge: float
    is_point: bool


def shadowing_light(resolved: ResolvedScene) -> Light | None:
    """The light whose shadows slices show; None where there is none."""
    lights = casting_lights(resolved)
    return resolved.lights[lights[0]] if lights else None


def check_lights(resolved: ResolvedScene) -> None:
    """SceneError unless slices can be swept by the scene's lights: one that casts shadows, and no rays of it that run
    along slices."""
    lights = casting_lights(resolved)
    if len(lights) > 1:
        what = f"got 'half-angle' with {len(lights)} lights that cast shadows"
        expected = "one (casts_shadow = false for others), or the method 'raycast'"
        raise SceneError(f"{resolved.origin}: slicing.geometry", what, expected)
    light = shadowing_light(resolved)
    if light is None or _is_directional(light, resolved.volume.grid):
        return
    widest = _widest(light, resolved.volume.grid)
    if widest > WIDEST:
        what = f"the point light sees the volume as much as {widest:.0f} degrees off its middle"
        where = f"{resolved.origin}: light[{lights[0]}].position"
        raise SceneError(where, what, f"at most {WIDEST:g} with the geometry 'half-angle': a light farther away")


def half_angle_plan(resolved: ResolvedScene, camera: Camera, size: tuple[int, int, int]) -> HalfAnglePlan:
    """The slabs of a volume of ``size`` lattice points (x, y, z) for ``camera`` (complete). RenderError where they are
    more than 2^20."""
    grid, light = resolved.volume.grid, shadowing_light(resolved)
    forward = np.asarray(camera.basis()[0], np.float64)
    normal, towards_eye = forward, False
    if light is not None:
        way = _way(light, grid)
        towards_eye = bool(way @ forward < 0.0)
        normal = unit_vector(way - forward if towards_eye else way + forward)
    space = LocalSpace(grid, size)
    along = normal @ space.matrix
    far = 0.5 * float(np.abs(along) @ (np.asarray(size, np.float64) - 1.0))  # from the middle, in edges
    spacing = resolved.integration.step * float(abs(normal @ forward))
    count = slab_count(2.0 * far, spacing) if resolved.slicing.slices is None else resolved.slicing.slices
    if count > MOST_SLICES:
        what = f"{count} slices by the method 'slicing'"
        raise RenderError(f"{resolved.origin}: integration.step", what, f"at most {MOST_SLICES}: longer steps")
    if resolved.slicing.slices is not None:
        spacing = 2.0 * far / count
    across = np.append(along, normal @ space.shift) / spacing
    across[3] += 0.5 * count
    return HalfAnglePlan(normal, across, count, spacing, towards_eye)


def light_texels(resolved: ResolvedScene, light: Light) -> LightTexels:
    """The texels of a ``light`` that all of the volume is in, as many along the longer side of the light's picture as
    [shadow] says."""
    grid = resolved.volume.grid
    middle = _middle(grid)
    way = _way(light, grid)
    directional = _is_directional(light, grid)
    radius = _radius(grid)
    eye = middle - 4.0 * radius * way if directional else np.asarray(light.position, np.float64)
    up = np.eye(3)[int(np.argmin(np.abs(way)))]
    given = {"position": eye.tolist(), "target": middle.tolist(), "up": up.tolist()}
    _, right, above = Camera(**given).basis()
    away = grid.world_corners() - eye
    across = np.abs(np.stack([away @ right, away @ above]))
    if not directional:
        across = across / (away @ way)
    half = np.maximum(across.max(axis=1), 1e-9 * (radius if directional else 1.0))
    texel = 2.0 * half.max() / (_resolution(resolved))
    width, height = (max(2, int(np.ceil(2.0 * side / texel - 1e-6))) for side in half)
    reach = 0.5 * texel * height
    if directional:
        camera = Camera(projection="orthographic", height=2.0 * reach, **given)
    else:
        camera = Camera(fov_degrees=float(np.degrees(2.0 * np.arctan(reach))), **given)
    frame = ray_frame(camera, grid, width, height)
    per_edge = grid.smallest_edge / texel if directional else 1.0 / texel
    return LightTexels(camera, frame, width, height, _texel_rows(frame, directional), per_edge, not directional)


def half_angle_row(resolved: ResolvedScene, plan: HalfAnglePlan, texels: LightTexels | None) -> np.ndarray:
    """``HalfAngle`` [1] of cl/half_angle.h."""
    row = np.zeros(1, HALF_ANGLE)
    row["across"], row["own_share"] = plan.across, _OWN_SHARES[resolved.slicing.light_at]
    row["size"] = (2, 2, plan.count, 0)
    if texels is not None:
        row["size"] = (texels.width, texels.height, plan.count, 0)
        row["light_x"], row["light_y"], row["light_w"] = texels.rows
        row["texels"], row["is_point"] = texels.per_edge, texels.is_point
    return row


def _resolution(resolved: ResolvedScene) -> int:
    if resolved.shadow is None:
        raise ValueError("the scene has no [shadow] table")
    return resolved.shadow.resolution


def _texel_rows(frame: RayFrame, directional: bool) -> np.ndarray:
    """``LightTexels.rows`` of the rays of ``frame``."""
    centre = np.asarray(frame.centre)
    if directional:  # p = origin + u du + v dv + t forward
        inverse = np.linalg.inv(np.stack([frame.du, frame.dv, frame.forward], axis=1))
        uv = np.column_stack([inverse[:2], -inverse[:2] @ frame.origin])
        uv[:, 3] += centre
        return np.vstack([uv, [0.0, 0.0, 0.0, 1.0]])
    # p = eye + z (forward + u ray_du + v ray_dv)
    eye = frame.origin - frame.distance * frame.forward
    inverse = np.linalg.inv(np.stack([frame.ray_du, frame.ray_dv, frame.forward], axis=1))
    rows = np.column_stack([inverse, -inverse @ eye])
    rows[:2] += centre[:, None] * rows[2]
    return rows


def _middle(grid: Grid) -> np.ndarray:
    return grid.world_corners().mean(axis=0)


def _radius(grid: Grid) -> float:
    return float(np.linalg.norm(grid.world_corners() - _middle(grid), axis=1).max())


def _is_directional(light: Light, grid: Grid) -> bool:
    if light.type == "directional":
        return True
    return bool(np.linalg.norm(np.asarray(light.position, np.float64) - _middle(grid)) > _FAR * _radius(grid))


def _way(light: Light, grid: Grid) -> np.ndarray:
    """The direction of the light in the middle of the volume, a unit vector in the world."""
    if light.type == "directional":
        return unit_vector(np.asarray(light.direction, np.float64))
    return unit_vector(_middle(grid) - np.asarray(light.position, np.float64))


def _widest(light: Light, grid: Grid) -> float:
    """Degrees between the light's direction in the middle of the volume and those to its corners."""
    position = np.asarray(light.position, np.float64)
    if np.linalg.norm(position - _middle(grid)) < 1e-6 * _radius(grid):
        return 180.0
    away = grid.world_corners() - position
    lengths = np.linalg.norm(away, axis=1)
    cosines = away @ _way(light, grid) / np.where(lengths > 0, lengths, 1.0)
    return float(np.degrees(np.arccos(np.clip(np.where(lengths > 0, cosines, -1.0), -1.0, 1.0)).max()))
