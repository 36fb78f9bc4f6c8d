"""What is refined, and the order that theory expects: the rows of the verification by convergence.

Etiene et al. 2014 ("Verifying volume rendering using discretization error analysis", IEEE TVCG
20(1)) refine the step along the ray, the grid and the pixels. Each row here refines one of them,
and compares with a value that knows nothing of what is refined:

  step   the exact integral of the same trilinear field (clvol.integrators.reference.picture)
  grid   the integral of the analytic field that the grid samples (``analytic_picture`` below)
  pixel  exact values at points of the image that are the centre of no pixel

Scenes are on [-1, 1]^3, h of steps and voxels in the same units. Errors are RMS over rays and RGBA.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol import Camera, Scene, TransferFunction, Volume
from clvol.accuracy.convergence import Convergence
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.reference.picture import render_reference, to_index
from clvol.scene import ImageSettings, Integration
from clvol.transfer.preintegration import preintegrate
from clvol.volume.procedural import LinearRamp, Smooth, sample, unit_box

if TYPE_CHECKING:
    from clvol.opencl.context import DeviceContext
    from clvol.scene.resolve import ResolvedScene

BAND = 0.2  # about the expected order
SIDE = 24  # pixels an edge, but for the pixel row
TOLERANCE = 1e-10  # of the exact integral
FLOOR_REFINEMENT = 8  # the floor is measured at a step this many times finer than the finest
FINE_STEP = 1 / 512  # of the pixel row: its error is far below that of the pixels

# --- scenes ---------------------------------------------------------------------------------------

FIELD = Smooth(
    waves=((1.9, 0.7, 1.1), (-0.8, 2.1, -1.3), (1.2, -1.0, 2.3)), amplitudes=(0.2, 0.15, 0.1)
)  # 0.05 .. 0.95
RIPPLES = Smooth(
    waves=tuple(tuple(2.5 * k for k in wave) for wave in FIELD.waves), amplitudes=FIELD.amplitudes
)
RAMP = LinearRamp((0.125, 0.125, 0.1875), 0.5)  # float32 holds it, and its samples, exactly
SLANT = LinearRamp((0.1, 0.15, 0.2), 0.5)  # one that float32 rounds

_RED, _BLUE = (0.9, 0.2, 0.1), (0.1, 0.6, 1.0)
SMOOTH = TransferFunction([0, 1], [0.02, 0.3], [_RED, _BLUE], opacity_unit=0.5)
STEEP = TransferFunction([0, 1], [0.05, 0.99], [_RED, _BLUE])
KINKS = TransferFunction(
    [0.0, 0.35, 0.5, 0.65, 1.0],
    [0.05, 0.1, 0.8, 0.1, 0.6],
    [[1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]],
)
STEP = TransferFunction([0, 0.5, 0.5, 1], [0.05, 0.05, 0.7, 0.7], [_RED, _RED, _BLUE, _BLUE])


# Eyes: askew to all axes, so that steps do not fall in with voxels; along the diagonal of the cube;
# and one whose rays all enter at z = 1 and leave at z = -1, parallel to no face, so that no edge of
# the volume runs through the picture.
_ASKEW = (2.9, 1.9, 4.2)
_ALONG, _AGAINST = (-3.1, -2.7, -3.4), (3.1, 2.7, 3.4)
_THROUGH = (0.9, 0.6, 5.2)


@dataclass(frozen=True, eq=False)
class Case:
    """A volume on [-1, 1]^3, a transfer function and where the eye is. The view is narrow: all
    its rays run through the inside of the volume's projection."""

    volume: Volume
    function: TransferFunction
    eye: tuple[float, float, float] = _ASKEW

    def scene(self, size: int, step: float, **integration: Any) -> ResolvedScene:
        """``size`` by ``size`` pixels; ``step`` in world units."""
        # Steps are even: what follows the data has an error of its own, whatever the size of a voxel.
        integration = {"early_termination": 0.0, "step_error": 0.0, **integration}
        return Scene(
            volume=self.volume,
            transfer_function=self.function,
            camera=Camera(position=self.eye, target=(0.0, 0.0, 0.0), fov_degrees=10.0),
            image=ImageSettings(width=size, height=size),
            integration=Integration(step=step / self.volume.grid.smallest_edge, **integration),
        ).resolve()


def gridded(field, n: int) -> Volume:
    """``field`` at n samples an axis."""
    return sample(field, (n, n, n), *unit_box((n, n, n)))


def one_cell() -> Volume:
    """0.1 + 0.9 u v w, u, v, w from 0 to 1: along the diagonal (1, 1, 1) it rises ever faster."""
    corners = np.full((2, 2, 2), 0.1, np.float32)
    corners[1, 1, 1] = 1.0
    return Volume(corners, *unit_box((2, 2, 2)))


def bytes_of_field(n: int) -> Volume:
    """FIELD as 8-bit voxels."""
    field = gridded(FIELD, n)
    data = np.rint(255 * field.data).astype(np.uint8)
    return Volume(data, field.grid.spacing, field.grid.origin)


def over_bytes(function: TransferFunction) -> TransferFunction:
    values, unit = 255 * function.values, function.opacity_unit
    return TransferFunction(values, function.opacities, function.colors, unit)


# --- pictures -------------------------------------------------------------------------------------


def raycast(
    context: DeviceContext,
    scene: ResolvedScene,
    spoil: Callable[[Raycaster], None] | None = None,
) -> np.ndarray:
    """rgba, float64 [height, width, 4]; by a ray caster that ``spoil`` has changed, for tests."""
    caster = Raycaster(context, scene)
    if spoil is not None:
        spoil(caster)
    image = scene.image
    return caster.render(scene.camera, image.width, image.height).rgba.astype(np.float64)


def exact(context: DeviceContext, scene: ResolvedScene, pixels=None) -> np.ndarray:
    return render_reference(scene, context.device, TOLERANCE, pixels)[0]


def _without_self_attenuation(scene: ResolvedScene) -> np.ndarray:
    return chords_picture(scene, segment=segment_without_self_attenuation)


def _rates(function: TransferFunction, s: np.ndarray) -> np.ndarray:
    """(c tau, tau) a world length, [..., 4]."""
    tau = function.extinction(s)[..., None]
    return np.concatenate([function.color(s) * tau, tau], axis=-1)


def segment_without_self_attenuation(
    function: TransferFunction, front: np.ndarray, back: np.ndarray, length: np.ndarray
) -> np.ndarray:
    """As ``preintegrate``, but with C = int c tau dt: light is not attenuated within its own segment
    (Engel, Kraus and Ertl 2001, their approximation of the colour). Opacity is as always. By
    Gauss-Legendre, for functions without control points between ``front`` and ``back``."""
    x, w = np.polynomial.legendre.leggauss(8)
    s = front[..., None] + 0.5 * (x + 1.0) * (back - front)[..., None]
    integrals = 0.5 * length[..., None] * np.einsum("j,...jk->...k", w, _rates(function, s))
    opacity = -np.expm1(-integrals[..., 3:])
    return np.concatenate([integrals[..., :3], opacity], axis=-1)


def chords_picture(
    scene: ResolvedScene,
    last_piece: bool = True,
    attenuate: bool = True,
    segment: Callable[..., np.ndarray] = preintegrate,
) -> np.ndarray:
    """Pre-integration as published, in double precision on the host: values at the ends of each
    segment, linear between them, no correction, each ``segment`` integrated by itself and composited.
    Without ``last_piece`` or without ``attenuate`` (between segments) it is wrong, for tests."""
    from scipy.ndimage import map_coordinates

    volume, step = scene.volume, scene.integration.step * scene.volume.grid.smallest_edge
    origins, directions = _rays(scene)
    origins, directions = to_index(volume.grid, origins, directions)
    start, end = box_span(origins, directions, 0.0, np.array(volume.grid.size) - 1.0)
    whole = np.floor((end - start) / step)
    i = np.arange(int(whole.max()) + 2)
    last = end if last_piece else start + whole * step
    t = np.minimum(start[:, None] + i * step, last[:, None])  # beyond it: segments of length 0
    points = origins[:, None, :] + t[..., None] * directions[:, None, :]
    values = map_coordinates(
        volume.data, points[..., ::-1].reshape(-1, 3).T, np.float64, order=1, mode="nearest"
    ).reshape(t.shape)
    segments = segment(
        scene.transfer_function, values[:, :-1], values[:, 1:], np.diff(t, axis=1)
    )
    rgba = np.zeros((len(t), 4))
    for k in range(segments.shape[1]):
        rgba += (1.0 - rgba[:, 3:] if attenuate else 1.0) * segments[:, k]
    return rgba.reshape(scene.image.height, scene.image.width, 4)


_PANELS, _POINTS = 24, 16


def analytic_picture(field, scene: ResolvedScene) -> np.ndarray:
    """The exact integral of ``field`` itself along the rays of ``scene``, rgba [height, width, 4].

    Gauss-Legendre panels along each ray; the optical depth within a panel by integrating the
    interpolating polynomial. For fields and functions that are smooth on [-1, 1]^3: about 1e-13.
    """
    origins, directions = _rays(scene)
    start, end = box_span(origins, directions, -1.0, 1.0)
    x, w = np.polynomial.legendre.leggauss(_POINTS)
    legendre = np.polynomial.legendre
    # within[i, j]: the integral from -1 to x_i of the polynomial that is 1 at x_j, 0 at the others.
    primitives = np.stack(
        [legendre.legval(x, legendre.legint(row, lbnd=-1)) for row in np.eye(_POINTS)], axis=1
    )
    within = primitives @ np.linalg.inv(legendre.legvander(x, _POINTS - 1))
    half = 0.5 * (end - start)[:, None, None] / _PANELS
    t = start[:, None, None] + half * (2 * np.arange(_PANELS)[:, None] + 1 + x)  # [ray, panel, j]
    points = origins[:, None, None, :] + t[..., None] * directions[:, None, None, :]
    rates = _rates(scene.transfer_function, field(*np.moveaxis(points, -1, 0)))
    tau = rates[..., 3]
    panels = half[..., 0] * (tau @ w)
    before = np.cumsum(panels, axis=1) - panels
    depth = before[..., None] + half * (tau @ within.T)
    light = rates[..., :3] * np.exp(-depth)[..., None]
    color = np.einsum("rpjc,j,rp->rc", light, w, np.broadcast_to(half[..., 0], panels.shape))
    opacity = -np.expm1(-panels.sum(axis=1))
    rgba = np.concatenate([color, opacity[:, None]], axis=1)
    return rgba.reshape(scene.image.height, scene.image.width, 4)


def _rays(scene: ResolvedScene) -> tuple[np.ndarray, np.ndarray]:
    origins, directions = scene.camera.world_rays(scene.image.width, scene.image.height)
    return origins.reshape(-1, 3), directions.reshape(-1, 3)


def box_span(origins, directions, lower, upper) -> tuple[np.ndarray, np.ndarray]:
    """Where rays [n, 3] enter and leave the box ``lower`` to ``upper``; all have to meet it."""
    with np.errstate(divide="ignore"):  # a component of 0: infinite, which is right
        a, b = (lower - origins) / directions, (upper - origins) / directions
    start, end = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    assert np.all((0 < start) & (start < end)), "a ray misses the volume"
    return start, end


def bilinear(picture: np.ndarray, points: np.ndarray) -> np.ndarray:
    """``picture`` [h, w, 4] between its pixel centres, at ``points`` [n, 2] (row, column)."""
    low = np.floor(points).astype(int)
    (fr, fc), (r, c) = (points - low).T[..., None], low.T
    top = picture[r, c] * (1 - fc) + picture[r, c + 1] * fc
    bottom = picture[r + 1, c] * (1 - fc) + picture[r + 1, c + 1] * fc
    return top * (1 - fr) + bottom * fr


def rms(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean((a - b) ** 2)))


# --- rows -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Row:
    """``measure(context)`` runs it. ``refined``: "step", "grid" or "pixel". ``reason``:
    why theory expects this order."""

    name: str
    refined: str
    title: str
    expected: float
    reason: str
    measure: Callable[[DeviceContext], Convergence]
    band: float = BAND


def step_row(
    name: str,
    title: str,
    expected: float,
    reason: str,
    case: Callable[[], Case],
    steps: tuple[float, ...],
    channels: slice = slice(0, 4),
    spoil: Callable[[Raycaster], None] | None = None,
    host: Callable[[ResolvedScene], np.ndarray] | None = None,
    **integration: Any,
) -> Row:
    """Refines the step. ``channels`` are compared; ``host(scene)`` may draw for the ray caster."""

    def measure(context: DeviceContext) -> Convergence:
        shown = case()
        reference = exact(context, shown.scene(SIDE, 1.0, **integration))

        def error(step: float) -> float:
            scene = shown.scene(SIDE, step, **integration)
            rgba = raycast(context, scene, spoil) if host is None else host(scene)
            return rms(rgba[..., channels], reference[..., channels])

        errors = tuple(error(step) for step in steps)
        if host is not None:
            return Convergence(steps, errors, TOLERANCE)
        # The floor: of the error at a far finer step, what theory does not expect to be left there.
        left = error(steps[-1] / FLOOR_REFINEMENT)
        own = errors[-1] / FLOOR_REFINEMENT**expected
        return Convergence(steps, errors, math.sqrt(max(left**2 - own**2, 0.0)))

    return Row(name, "step", title, expected, reason, measure)


GRIDS = (9, 17, 33, 65, 129)  # samples an axis


def _grid_row(name: str, title: str, reason: str, classification: str | None) -> Row:
    """Refines the grid; the picture by the reference or, with ``classification``, by the ray caster
    with a step of one voxel."""

    def measure(context: DeviceContext) -> Convergence:
        def error(n: int) -> float:
            case, edge = Case(gridded(FIELD, n), SMOOTH), 2.0 / (n - 1)
            scene = case.scene(SIDE, edge, classification=classification or "post")
            rgba = exact(context, scene) if classification is None else raycast(context, scene)
            return rms(rgba, analytic_picture(FIELD, scene))

        # What is left where the grid is not at fault: trilinear interpolation keeps a ramp.
        ramp = Case(gridded(SLANT, GRIDS[-1]), SMOOTH)
        scene = ramp.scene(SIDE, 2.0 / (GRIDS[-1] - 1), classification="preintegrated")
        rgba = exact(context, scene) if classification is None else raycast(context, scene)
        floor = rms(rgba, analytic_picture(SLANT, scene))
        return Convergence(tuple(2.0 / (n - 1) for n in GRIDS), tuple(map(error, GRIDS)), floor)

    return Row(name, "grid", title, 2.0, reason, measure)


WIDTHS = (8, 16, 32, 64, 128)
_FINE = 977  # prime: but for the middle, no pixel centre of it is one of the pictures above
_PLACES = 300


def _pixel(context: DeviceContext) -> Convergence:
    case = Case(gridded(RIPPLES, 33), SMOOTH, _THROUGH)
    margin = int(np.ceil(_FINE / WIDTHS[0] / 2)) + 1  # between the outermost pixel centres
    places = np.random.default_rng(7).integers(margin, _FINE - margin, (_PLACES, 2))
    reference = exact(context, case.scene(_FINE, FINE_STEP), places)

    def error(width: int) -> float:
        picture = raycast(context, case.scene(width, FINE_STEP, classification="post"))
        return rms(bilinear(picture, (places + 0.5) * width / _FINE - 0.5), reference)

    coarse = case.scene(WIDTHS[0], FINE_STEP, classification="post")
    floor = rms(raycast(context, coarse), exact(context, coarse))
    return Convergence(tuple(1 / w for w in WIDTHS), tuple(map(error, WIDTHS)), floor)


def steps_of_two(coarsest: int, finest: int) -> tuple[float, ...]:
    """2^-coarsest .. 2^-finest"""
    return tuple(2.0**-k for k in range(coarsest, finest + 1))


ROWS: tuple[Row, ...] = (
    step_row(
        "post", "post-classified", 2.0,
        "the midpoint rule, for the optical depth and for the light",
        lambda: Case(gridded(FIELD, 17), SMOOTH), steps_of_two(1, 6), classification="post",
    ),
    step_row(
        "pre", "pre-classified", 2.0,
        "the midpoint rule on interpolated extinction and emission, against the integral of these",
        lambda: Case(gridded(FIELD, 17), SMOOTH), steps_of_two(1, 6), classification="pre",
    ),
    step_row(
        "preintegrated", "pre-integrated", 2.0,
        "the chord is the trapezoid rule; its correction leaves h^2 at the kinks in cell faces",
        lambda: Case(gridded(FIELD, 3), SMOOTH), steps_of_two(2, 5), classification="preintegrated",
    ),
    step_row(
        "chords", "pre-integrated, as published (host)", 2.0,
        "the chord is the trapezoid rule for the value; all else in a segment is exact",
        lambda: Case(one_cell(), SMOOTH, _ALONG), steps_of_two(1, 6), host=chords_picture,
        classification="preintegrated",
    ),
    step_row(
        "preintegrated-rising", "pre-integrated, one cell, value speeds up", 3.0,
        "no kink along the ray, and the curvature correction takes the h^2 away",
        lambda: Case(one_cell(), SMOOTH, _ALONG), steps_of_two(0, 3),
        classification="preintegrated",
    ),
    step_row(
        "preintegrated-falling", "pre-integrated, one cell, value slows down", 2.0,
        "a corrected back end that would pass its sample is held there: half of the h^2 stays",
        lambda: Case(one_cell(), SMOOTH, _AGAINST), steps_of_two(1, 5),
        classification="preintegrated",
    ),
    step_row(
        "no-self-attenuation", "attenuation in the segment neglected (host): colour", 1.0,
        "each segment is too bright by tau h / 2 of its light",
        lambda: Case(gridded(FIELD, 17), SMOOTH), steps_of_two(2, 7), slice(0, 3),
        host=_without_self_attenuation, classification="preintegrated",
    ),
    step_row(
        "no-self-attenuation-opacity", "attenuation in the segment neglected (host): opacity", 2.0,
        "opacity has no such term: as pre-integrated",
        lambda: Case(gridded(FIELD, 3), SMOOTH), steps_of_two(2, 5), slice(3, 4),
        host=_without_self_attenuation, classification="preintegrated",
    ),
    step_row(
        "post-kinks", "post-classified, kinks in the function", 2.0,
        "a kink costs one segment O(h^2), as much as all the others together",
        lambda: Case(gridded(FIELD, 17), KINKS), steps_of_two(3, 7), classification="post",
    ),
    step_row(
        "preintegrated-kinks", "pre-integrated, kinks in the function", 2.0,
        "the integral is exact across kinks; the chord stays what it was",
        lambda: Case(gridded(FIELD, 9), KINKS), steps_of_two(2, 5), classification="preintegrated",
    ),
    step_row(
        "post-step", "post-classified, step in the function", 1.0,
        "the segment with the step is all on one side: O(h), however smooth the rest",
        lambda: Case(gridded(FIELD, 17), STEP), steps_of_two(2, 6), classification="post",
    ),
    step_row(
        "preintegrated-step", "pre-integrated, step in the function", 2.0,
        "the integral knows the step; the chord crosses its value O(h^2) off",
        lambda: Case(one_cell(), STEP, _ALONG), steps_of_two(1, 4), classification="preintegrated",
    ),
    step_row(
        "nearest", "post-classified, nearest filter", 1.0,
        "the field jumps between voxels: as with a step, at every one of them",
        lambda: Case(bytes_of_field(17), over_bytes(SMOOTH)), steps_of_two(5, 9),
        classification="post", filter="nearest",
    ),
    _grid_row(
        "grid-reference", "exact integral of the trilinear field",
        "trilinear interpolation of a smooth field", None,
    ),
    _grid_row(
        "grid-post", "post-classified, step of a voxel",
        "trilinear interpolation and the midpoint rule", "post",
    ),
    _grid_row(
        "grid-preintegrated", "pre-integrated, step of a voxel",
        "trilinear interpolation and the chord", "preintegrated",
    ),
    Row(
        "pixel", "pixel", "picture between pixel centres", 2.0,
        "bilinear interpolation of a picture that is smooth inside the projection", _pixel,
    ),
)  # fmt: skip
