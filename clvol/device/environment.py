"""Environment maps: light from all directions, averaged over lobes beforehand, so that each sample needs
one look-up (diffuse and specular environment maps: Engel and Ertl 2002; Ramamoorthi and Hanrahan 2001;
Heidrich and Seidel 1999).

A radiance map covers all directions by latitude and longitude: the unit direction (x, y, z), y up,
is at column u w, row v h with u = atan2(x, -z) / 2 pi + 1/2 and v = acos(y) / pi: row 0 is +y, the
middle column looks along -z, +x is to the right of it.

Means over lobes (R.w)^e are sums over all texels with their solid angles and the lobe normalised by
the same sums. Rows of latitude make the sum over longitude a circular convolution, done by FFT: no
texels are merged first, so even a sun of one texel keeps its position. The irradiance
over pi is the same mean with e = 1. Order-2 spherical harmonics would be smaller than its map, but
they miss the irradiance of a sun of one texel by up to 9 % of its peak (rms 3.6 %) and go below
zero behind it; the map misses it by up to 1.2 % at the terminator and 0.2 % elsewhere (rms 0.07 %).
Other lobes with e >= 1 are met to 1 % of a sun's peak; those of e < 1 end at the horizon in a
corner (a step, e = 0) that the map rounds off over a cell.

Maps are stored by octahedron (Engelhardt and Dachsbacher 2008): no trigonometry in the kernel.
Unlike there, values are at nodes, including the square's edges and corners: nodes on an edge
with the same direction hold the same value, so that no border is needed and there is no seam.
Values are linear over triangles, each cell being cut in two parallel to the equator's line in its
quadrant: cells interpolated bilinearly would cross that crease, with an error of the first
order of their size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LARGEST_ROWS = 1024  # of a radiance map; larger ones are averaged first
_SMALLEST_NODES, _LARGEST_NODES = 97, 769  # per edge of maps of means
_LARGEST_SHARP = 2049  # nodes per edge of a map of the radiance itself
_SMALLEST_ROWS, _MOST_ROWS = 96, 768  # of latitude, on which means are computed
_NEGLIGIBLE = 1e-7  # of a lobe's peak
_BLOCK = 16  # rows of means computed at once: bounds memory


@dataclass(frozen=True, eq=False)
class RadianceMap:
    """Radiance from all directions: ``texels`` float32 [h, w, 3], linear, by latitude and longitude
    as above, then turned about the world's +y axis by ``rotation`` radians (right-handed: seen from
    +y, counter-clockwise)."""

    texels: np.ndarray
    rotation: float = 0.0


@dataclass(frozen=True)
class MapPlace:
    """The position of an octahedral map: ``size`` nodes per edge, from node ``offset`` on, row by row."""

    size: int
    offset: int


@dataclass(frozen=True, eq=False)
class EnvironmentMaps:
    """The maps that the kernel reads, in one buffer: ``nodes`` float32 [n, 4] (r, g, b, 0).

    ``diffuse``: mean radiance under the cosine lobe about a normal (irradiance / pi). ``specular``:
    mean radiance in the lobe (R.w)^(shininess / 4). ``sky``: the radiance itself, or None if not
    requested.
    """

    nodes: np.ndarray
    diffuse: MapPlace
    specular: MapPlace
    sky: MapPlace | None


def environment_maps(radiance: RadianceMap, shininess: float, sky: bool = False) -> EnvironmentMaps:
    """The maps for Blinn-Phong's ``shininess`` (>= 0).

    A lobe whose width (1 / sqrt(e)) is below a texel shows the radiance itself. Of 1024 x 2048
    texels they take about 0.7 s of one core (2 s beyond a shininess of 5000, 0.4 s more with the
    sky) and at most 64 MB. Beyond a shininess of 7000, maps of more than 256 rows have coarser
    nodes than the lobe requires: at 40000 a sun of one texel is met to 5 % of its peak.
    """
    texels = _at_most(radiance.texels, LARGEST_ROWS)
    exponent = shininess / 4.0
    sharp = np.sqrt(exponent) > texels.shape[0] / np.pi
    parts = [_mean_map(texels, 1.0, radiance.rotation)]
    if not sharp:
        same = exponent == 1.0
        parts.append(parts[0] if same else _mean_map(texels, exponent, radiance.rotation))
    if sharp or sky:
        parts.append(_sharp_map(texels, radiance.rotation))
    offsets = np.cumsum([0] + [len(part) ** 2 for part in parts])
    nodes = np.zeros((offsets[-1], 4), np.float32)
    places = []
    for part, offset in zip(parts, offsets):
        places.append(MapPlace(len(part), int(offset)))
        nodes[offset : offset + len(part) ** 2, :3] = part.reshape(-1, 3)
    return EnvironmentMaps(nodes, places[0], places[1], places[-1] if sky else None)


# --- look-ups: numpy references of cl/environment.h, and the sums themselves


def look_up(nodes: np.ndarray, place: MapPlace, directions: np.ndarray) -> np.ndarray:
    """Radiance [..., 3] in unit ``directions`` [..., 3] of the map at ``place``, in float64."""
    u, v = octahedral_coordinates(directions)
    cells = (place.size - 1) // 2  # from the middle to an edge
    column, row = np.abs(u) * cells, np.abs(v) * cells
    i, j = (np.clip(np.floor(f), 0, cells - 1).astype(np.int64) for f in (column, row))
    s, t = column - i, row - j
    outer = (s + t > 1.0).astype(np.int64)
    aside, down = np.where(u < 0.0, -1, 1), np.where(v < 0.0, -place.size, place.size)
    at = place.offset + cells * (place.size + 1) + i * aside + j * down
    values = nodes[:, :3].astype(np.float64)
    corner = values[at + outer * (aside + down)]
    to_beside, to_below = values[at + aside] - corner, values[at + down] - corner
    s, t = np.where(outer, 1.0 - t, s), np.where(outer, 1.0 - s, t)
    return corner + s[..., None] * to_beside + t[..., None] * to_below


def lobe_mean(radiance: RadianceMap, directions: np.ndarray, exponent: float) -> np.ndarray:
    """The mean radiance [..., 3] in the lobe max(R.w, 0)^exponent about each of ``directions``
    [..., 3]: the plain sum over all texels at their centres, float64. Slow: for checking."""
    rows, columns = radiance.texels.shape[:2]
    theta, psi = _row_centres(rows), _column_centres(columns) - radiance.rotation
    ring = np.sin(theta)[:, None]
    y = np.broadcast_to(np.cos(theta)[:, None], (rows, columns))
    to = np.stack([ring * np.sin(psi), y, -ring * np.cos(psi)], axis=-1).reshape(-1, 3)
    weight = np.repeat(_row_weights(rows), columns)[:, None]
    weighted = radiance.texels.reshape(-1, 3).astype(np.float64) * weight
    flat = np.asarray(directions, np.float64).reshape(-1, 3)
    means = np.empty((len(flat), 3))
    for first in range(0, len(flat), _BLOCK):
        cosine = flat[first : first + _BLOCK] @ to.T
        lobe = np.where(cosine > 0.0, np.maximum(cosine, 0.0) ** exponent, 0.0)
        means[first : first + _BLOCK] = (lobe @ weighted) / (lobe @ weight)
    return means.reshape(np.shape(directions))


# --- the octahedron: |x| + |y| + |z| = 1 unfolded on [-1, 1]^2, +y in the middle, -y at the corners


def octahedral_coordinates(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u, v in [-1, 1] of ``directions`` [..., 3]."""
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    length = np.abs(x) + np.abs(y) + np.abs(z)
    u, v = x / length, z / length
    below = y < 0.0
    outer_u = np.where(u < 0.0, -1.0, 1.0) * (1.0 - np.abs(v))
    outer_v = np.where(v < 0.0, -1.0, 1.0) * (1.0 - np.abs(u))
    return np.where(below, outer_u, u), np.where(below, outer_v, v)


def octahedral_directions(size: int, rows: slice = slice(None)) -> np.ndarray:
    """Directions, of lengths from 0.57 to 1, of the nodes in ``rows``: float64 [rows, size, 3]."""
    edge = np.linspace(-1.0, 1.0, size)
    u, v = edge[None, :], edge[rows, None]
    directions = np.empty((v.shape[0], size, 3))
    x, y, z = np.moveaxis(directions, -1, 0)
    np.subtract(1.0 - np.abs(u), np.abs(v), out=y)
    fold = np.maximum(-y, 0.0)
    np.subtract(u, np.copysign(fold, u), out=x)
    np.subtract(v, np.copysign(fold, v), out=z)
    return directions


def _nodes_for(spacing: float) -> int:
    """Nodes per edge, odd, so that neighbours are at most ``spacing`` radians apart: the octahedron
    stretches lengths by at most 3, in the middle of its faces, and a cell is 2 / (n - 1) wide."""
    return 2 * int(np.ceil(3.0 / spacing)) + 1


def _mean_map(texels: np.ndarray, exponent: float, rotation: float) -> np.ndarray:
    """The means at the nodes, float32 [n, n, 3]; nodes a quarter of the lobe's width apart."""
    wanted = _nodes_for(0.25 / np.sqrt(exponent)) if exponent > 0.0 else 0
    size = min(max(wanted, _SMALLEST_NODES), _LARGEST_NODES)
    means = interpolated(lobe_means(texels, exponent), octahedral_directions(size), rotation)
    # Near a sun the spline may leave the range of the means.
    return np.clip(means, 0.0, _largest(texels)).astype(np.float32)


def _sharp_map(texels: np.ndarray, rotation: float) -> np.ndarray:
    """The radiance at the nodes, bilinear between texels, float32 [n, n, 3]; nodes no farther apart
    than the texels at the equator, as long as that is not too many. A sun of one texel may gain or
    lose up to a fifth of its energy."""
    rows = texels.shape[0]
    size = min(max(_nodes_for(np.pi / rows), _SMALLEST_NODES), _LARGEST_SHARP)
    smooth = np.clip(_round_texels(texels), 0.0, _largest(texels))
    sharp = np.empty((size, size, 3), np.float32)
    padded = np.zeros((smooth.shape[0] + 2, smooth.shape[1] + 2, 4), np.float32)
    padded[..., :3] = _padded(smooth, 1)
    for first in range(0, size, 64):  # bounds memory
        part = slice(first, first + 64)
        at = _texel_coordinates(smooth.shape, octahedral_directions(size, part), rotation)
        sharp[part] = _bilinear(padded, *at)
    return sharp


def _largest(texels: np.ndarray) -> np.ndarray:
    return texels.max(axis=(0, 1)).astype(np.float64)


# --- means over lobes, on rows of latitude


def lobe_means(texels: np.ndarray, exponent: float) -> np.ndarray:
    """float64 [rows, 2 rows, 3]: the mean radiance of ``texels`` [h, w, 3] in the lobe
    max(R.w, 0)^exponent, by R's latitude and longitude as in a radiance map."""
    from scipy.fft import dct, next_fast_len

    height = texels.shape[0]
    # The spacing is a quarter of the lobe's width 1 / sqrt(e), or that of a clamped cosine.
    wanted = np.clip(np.ceil(4.0 * np.pi * np.sqrt(exponent)), _SMALLEST_ROWS, _MOST_ROWS)
    rows = next_fast_len(int(wanted), real=True)
    spectrum = _spectrum(texels, rows) * _row_weights(height)[:, None, None]
    # [mode, row, channel and part]: products with real lobes
    source = np.ascontiguousarray(spectrum.transpose(1, 0, 2)).view(np.float64)
    theta, theta_in = _row_centres(rows), _row_centres(height)
    across = np.sin(np.arange(rows + 1) * (0.5 * np.pi / rows)) ** 2  # sin^2 of half the longitude
    reach = np.arccos(_NEGLIGIBLE ** (1.0 / exponent)) if exponent > 0.0 else np.pi / 2
    means = np.empty((rows, 2 * rows, 3))
    for first in range(0, rows, _BLOCK):
        here = theta[first : first + _BLOCK]
        near = slice(
            np.searchsorted(theta_in, here[0] - reach), np.searchsorted(theta_in, here[-1] + reach)
        )
        lobe = _lobe(here[:, None, None], theta_in[None, near, None], across, exponent)
        lobe = np.ascontiguousarray(dct(lobe, type=1, axis=-1).transpose(2, 0, 1))
        modes = np.matmul(lobe, source[:, near]).view(np.complex128)
        ring = np.fft.irfft(modes.transpose(1, 0, 2), n=2 * rows, axis=1)
        means[first : first + _BLOCK] = ring[..., :3] / ring[..., 3:]
    return np.clip(means, 0.0, _largest(texels))


def _lobe(
    theta: np.ndarray, theta_in: np.ndarray, across: np.ndarray, exponent: float
) -> np.ndarray:
    """max(cos g, 0)^exponent, g the angle between directions: 1 - cos g without cancellation."""
    q = 2.0 * np.sin(0.5 * (theta - theta_in)) ** 2
    q = q + (2.0 * np.sin(theta) * np.sin(theta_in)) * across
    if exponent == 0.0:
        return (q < 1.0).astype(np.float64)
    np.minimum(q, 1.0, out=q)
    if exponent == 1.0:
        return 1.0 - q
    with np.errstate(divide="ignore"):  # the logarithm of 0
        return np.exp(exponent * np.log1p(-q))


def _spectrum(texels: np.ndarray, rows: int) -> np.ndarray:
    """Modes 0..rows of each row of texels as point sources, complex128 [h, rows + 1, 4], phases for
    2 ``rows`` columns; the upper half fades out, where lobes have little and corners would ring.
    The fourth channel is that of texels of 1."""
    width = texels.shape[1]
    from scipy.fft import rfft

    planes = np.ones((4, *texels.shape[:2]))
    planes[:3] = texels.transpose(2, 0, 1)
    half = rfft(planes)
    mode = np.arange(rows + 1)
    image = mode % width  # point sources: their spectrum is periodic
    modes = half[..., np.minimum(image, width - image)]
    np.conjugate(modes, out=modes, where=image > width - image)
    phase = np.exp(1j * np.pi * mode * (0.5 / rows - 1.0 / width))
    fade = np.cos(0.5 * np.pi * np.clip(2.0 * mode / rows - 1.0, 0.0, 1.0)) ** 2
    return (modes * (phase * fade)).transpose(1, 2, 0)


# --- latitude and longitude


def interpolated(texels: np.ndarray, directions: np.ndarray, rotation: float) -> np.ndarray:
    """float64 [..., 3]: ``texels`` [h, w, 3] in ``directions`` [..., 3] (any length) of the world
    in which the map is turned by ``rotation``, by the cubic spline through the texels' centres."""
    from scipy.ndimage import map_coordinates

    border = 16  # the spline's memory fades by a factor of 0.27 per texel
    padded = _padded(texels, border)
    at = [coordinate + border for coordinate in _texel_coordinates(texels.shape, directions, rotation)]
    return np.stack([map_coordinates(padded[..., k], at, np.float64) for k in range(3)], axis=-1)


def _bilinear(padded: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """float32 [..., 3], linear between texels' centres; ``padded``: float32 [h + 2, w + 2, 4]."""
    texels = padded.view(np.complex128).ravel()  # one item per texel, which is gathered several times as fast
    i, j = np.floor(column).astype(np.int32), np.floor(row).astype(np.int32)
    s, t = ((f - k)[..., None].astype(np.float32) for f, k in ((column, i), (row, j)))
    at = (j + 1) * np.int32(padded.shape[1]) + (i + 1)

    def along_row(at: np.ndarray) -> np.ndarray:
        left, right = (texels.take(a)[..., None].view(np.float32) for a in (at, at + 1))
        return left + s * (right - left)

    upper = along_row(at)
    return (upper + t * (along_row(at + padded.shape[1]) - upper))[..., :3]


def _padded(texels: np.ndarray, border: int) -> np.ndarray:
    """``texels`` with ``border`` more on each side: columns wrap, rows continue beyond the pole."""
    height, width = texels.shape[:2]
    rows, columns = np.arange(-border, height + border), np.arange(-border, width + border)
    over = (rows < 0) | (rows >= height)
    rows = np.where(rows < 0, -1 - rows, np.where(rows >= height, 2 * height - 1 - rows, rows))
    columns = columns[None, :] + np.where(over, width // 2, 0)[:, None]
    return texels[np.clip(rows, 0, height - 1)[:, None], columns % width]


def _texel_coordinates(
    shape: tuple[int, ...], directions: np.ndarray, rotation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Row in [-1/2, h - 1/2] and column in [-1/2, w - 1/2], texels' centres being whole numbers."""
    x, y, z = np.moveaxis(directions, -1, 0)
    turn = (np.arctan2(x, -z) + rotation) / (2.0 * np.pi) + 0.5
    row = np.arctan2(np.hypot(x, z), y) * (shape[0] / np.pi) - 0.5
    return row, (turn - np.floor(turn)) * shape[1] - 0.5


def _round_texels(texels: np.ndarray) -> np.ndarray:
    """Texels towards the poles, much narrower than high, smoothed along their row to the width that
    they have at the equator: nodes would step over them."""
    height, width = texels.shape[:2]
    sine = np.sin(_row_centres(height))[:, None]
    variance = (0.25 * np.pi / height) ** 2 * (1.0 / sine**2 - 1.0)
    apart = np.cos(2.0 * np.pi / width * np.arange(width)) - 1.0
    fade = np.fft.rfft(np.exp(apart / np.maximum(variance, 1e-12)), axis=1)
    fade = (fade / fade[:, :1])[..., None]
    return np.fft.irfft(np.fft.rfft(texels.astype(np.float64), axis=1) * fade, n=width, axis=1)


def _at_most(texels: np.ndarray, rows: int) -> np.ndarray:
    """``texels`` averaged by area to ``rows`` x 2 ``rows`` if they are more."""
    if texels.shape[0] <= rows:
        return texels
    height, width = texels.shape[:2]
    edges = np.cos(np.linspace(0.0, np.pi, height + 1))
    new = np.cos(np.linspace(0.0, np.pi, rows + 1))
    texels = _averaged(texels, -edges, -new)
    new = np.linspace(0.0, width, 2 * rows + 1)
    texels = _averaged(texels.swapaxes(0, 1), np.arange(width + 1.0), new)
    return texels.swapaxes(0, 1).astype(np.float32)


def _averaged(texels: np.ndarray, edges: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Means over the intervals between ``new`` edges of values that are constant between ``edges``, along
    axis 0, float64; each new interval is wider than any old one."""
    before = np.zeros((len(edges), *texels.shape[1:]))
    np.cumsum(texels * np.diff(edges)[:, None, None], axis=0, out=before[1:])
    at = np.interp(new, edges, np.arange(len(edges)))
    low = np.minimum(at.astype(np.int64), len(edges) - 2)
    part = (at - low)[:, None, None]
    integral = before[low] * (1.0 - part) + before[low + 1] * part
    return np.diff(integral, axis=0) / np.diff(new)[:, None, None]


def _row_centres(rows: int) -> np.ndarray:
    return (np.arange(rows) + 0.5) * (np.pi / rows)


def _column_centres(columns: int) -> np.ndarray:
    """atan2(x, -z) at the columns' centres."""
    return (np.arange(columns) + 0.5) * (2.0 * np.pi / columns) - np.pi


def _row_weights(rows: int) -> np.ndarray:
    """A row's solid angle, up to a factor."""
    return -np.diff(np.cos(np.linspace(0.0, np.pi, rows + 1)))
