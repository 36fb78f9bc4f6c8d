"""Environment maps: what is looked up is the mean over the lobe, on every device, without a
seam."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.paths import DATA

from clvol.device.environment import (
    LARGEST_ROWS,
    MapPlace,
    RadianceMap,
    environment_maps,
    lobe_mean,
    look_up,
    octahedral_coordinates,
    octahedral_directions,
)
from clvol.device.environment_file import ball_coordinates, cube_coordinates, cube_directions, load_radiance
from clvol.errors import SceneError
from clvol.opencl.arguments import reads, value, writes

SOURCE = Path(__file__).with_name("environment_look_up.cl")
STUDIO = DATA / "studio.exr"
EXPONENTS = [1.0, 2.0, 5.0, 25.0, 250.0]
ROWS = 64


def sphere(n: int, seed: int = 1) -> np.ndarray:
    """float64 [n, 3], even over the sphere."""
    directions = np.random.default_rng(seed).normal(size=(n, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def texel_directions(rows: int = ROWS) -> np.ndarray:
    """float64 [rows, 2 rows, 3] at the centres of a radiance map's texels."""
    theta = (np.arange(rows) + 0.5)[:, None] * np.pi / rows
    psi = (np.arange(2 * rows) + 0.5) * np.pi / rows - np.pi
    y = np.broadcast_to(np.cos(theta), (rows, 2 * rows))
    return np.stack([np.sin(theta) * np.sin(psi), y, -np.sin(theta) * np.cos(psi)], axis=-1)


def smooth(directions: np.ndarray) -> np.ndarray:
    """A radiance without symmetry, from 0.1 to 1.9."""
    x, y, z = np.moveaxis(directions, -1, 0)
    red = 1.0 + 0.5 * x + 0.4 * y * z
    green = 1.0 + 0.4 * z - 0.5 * x * y * y
    return np.stack([red, green, 1.0 - 0.6 * y + 0.3 * x * z], axis=-1)


def sun(row: int, column: int) -> np.ndarray:
    texels = np.zeros((ROWS, 2 * ROWS, 3), np.float32)
    texels[row, column] = (1e4, 5e3, 2e3)
    return texels


def noise(rows: int = ROWS) -> np.ndarray:
    return np.random.default_rng(3).random((rows, 2 * rows, 3), dtype=np.float32)


def write_exr(path: Path, texels: np.ndarray | None = None, **channels: np.ndarray) -> Path:
    import OpenEXR

    channels = channels or {"RGB": np.ascontiguousarray(texels, np.float32)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))
    return path


# --- the octahedron


def test_a_nodes_direction_has_the_nodes_coordinates():
    u, v = octahedral_coordinates(octahedral_directions(9)[1:-1, 1:-1])
    edge = np.linspace(-1.0, 1.0, 9)[1:-1]
    assert np.allclose(u, edge[None, :], atol=1e-15) and np.allclose(v, edge[:, None], atol=1e-15)


def test_nodes_of_the_same_direction_hold_the_same_value():
    maps = environment_maps(RadianceMap(noise(), 0.3), 20.0, sky=True)
    for place in (maps.diffuse, maps.specular, maps.sky):
        n = place.size
        nodes = maps.nodes[place.offset : place.offset + n * n].reshape(n, n, 4)
        for edge in (nodes[0], nodes[-1], nodes[:, 0], nodes[:, -1]):
            assert np.allclose(edge, edge[::-1], rtol=0.0, atol=1e-6)


# --- means


@pytest.mark.parametrize("shininess", [0.0, 1.0, 4.0, 20.0, 400.0, 1e6])
@pytest.mark.parametrize("shape", [(32, 64), (45, 90)])
def test_a_constant_environment_is_that_constant_everywhere(shape, shininess):
    color = np.array([0.3, 1.7, 12345.0], np.float32)
    radiance = RadianceMap(np.broadcast_to(color, (*shape, 3)).copy(), 0.7)
    assert np.all(environment_maps(radiance, shininess, sky=True).nodes[:, :3] == color)


def test_a_cosine_lobed_environment_gives_its_irradiance():
    """L = 1 + a.w: irradiance / pi = 1 + 2/3 a.N; the mean in a lobe of exponent e: 1 + (e+1)/(e+2)
    a.R."""
    a = np.array([0.5, -0.3, 0.4])
    texels = (1.0 + texel_directions(128) @ a)[..., None] * np.ones(3)
    maps = environment_maps(RadianceMap(texels.astype(np.float32)), 40.0)
    directions = sphere(5000)
    for place, factor in ((maps.diffuse, 2.0 / 3.0), (maps.specular, 11.0 / 12.0)):
        expected = 1.0 + factor * (directions @ a)
        error = look_up(maps.nodes, place, directions) - expected[:, None]
        assert np.abs(error).max() < 5e-4


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("name", ["noise", "sun", "sun at the pole", "sun at the seam"])
def test_maps_hold_the_sums_over_all_texels(name, exponent):
    """Largest and rms error, of the peak. The clamped cosine ends in a corner, that cells round
    off."""
    texels = {"noise": noise(), "sun": sun(20, 33), "sun at the pole": sun(0, 5),
              "sun at the seam": sun(31, 0)}[name]  # fmt: skip
    radiance = RadianceMap(texels, 0.7)
    directions = sphere(1000)
    maps = environment_maps(radiance, 4.0 * exponent)
    expected = lobe_mean(radiance, directions, exponent)
    error = np.abs(look_up(maps.nodes, maps.specular, directions) - expected) / expected.max()
    largest, rms = 0.013 if exponent == 1.0 else 0.01, 1e-3
    if name == "noise":
        largest, rms = 0.002, 5e-4
    assert error.max() < largest
    assert np.sqrt((error**2).mean()) < rms


@pytest.mark.parametrize("shininess", [4.0, 20.0, 400.0])
def test_the_mean_of_the_means_is_the_mean_radiance(shininess):
    texels = noise() + sun(40, 17)
    weight = -np.diff(np.cos(np.linspace(0.0, np.pi, ROWS + 1))) / 2.0
    mean = (texels.mean(axis=1, dtype=np.float64) * weight[:, None]).sum(axis=0)
    maps = environment_maps(RadianceMap(texels), shininess)
    everywhere = texel_directions(300)
    weight = -np.diff(np.cos(np.linspace(0.0, np.pi, 301))) / 2.0
    for place in (maps.diffuse, maps.specular):
        rows = look_up(maps.nodes, place, everywhere).mean(axis=1)
        assert np.allclose((rows * weight[:, None]).sum(axis=0), mean, rtol=3e-3)


def test_a_lobe_narrower_than_a_texel_shows_the_radiance():
    maps = environment_maps(RadianceMap(smooth(texel_directions()).astype(np.float32)), 1e6)
    directions = sphere(3000)
    got = look_up(maps.nodes, maps.specular, directions)
    assert np.abs(got - smooth(directions)).max() < np.pi / ROWS / 8  # an eighth of a texel


@pytest.mark.parametrize("row", [0, 1, 2, 10, 31])
def test_the_radiance_map_keeps_a_suns_energy(row):
    """One texel, even a sliver beside the pole, is spread over a few nodes: right to 20 %."""
    everywhere = texel_directions(400)
    weight = -np.diff(np.cos(np.linspace(0.0, np.pi, 401))) / 2.0
    for column in (0, 17, 18):
        maps = environment_maps(RadianceMap(sun(row, column)), 1e6)
        solid_angle = -np.diff(np.cos(np.linspace(0.0, np.pi, ROWS + 1)))[row] / (4 * ROWS)
        rows = look_up(maps.nodes, maps.specular, everywhere)[..., 0].mean(axis=1)
        assert (rows * weight).sum() == pytest.approx(1e4 * solid_angle, rel=0.2)


def test_the_sky_is_the_radiance_whatever_the_lobe():
    radiance = RadianceMap(smooth(texel_directions()).astype(np.float32))
    directions = sphere(3000)
    for shininess in (20.0, 1e6):
        maps = environment_maps(radiance, shininess, sky=True)
        error = look_up(maps.nodes, maps.sky, directions) - smooth(directions)
        assert np.abs(error).max() < np.pi / ROWS / 8  # an eighth of a texel
    assert environment_maps(radiance, 20.0).sky is None


def test_a_turn_about_y_turns_all_maps():
    """By 90 degrees what was at -z (the middle) is at -x."""
    angle = 1.1
    x, y, z = np.moveaxis(sphere(2000), -1, 0)
    c, s = np.cos(angle), np.sin(angle)
    turned = np.stack([x * c + z * s, y, z * c - x * s], axis=-1)
    texels = smooth(texel_directions()).astype(np.float32)
    still = environment_maps(RadianceMap(texels), 20.0, sky=True)
    maps = environment_maps(RadianceMap(texels, angle), 20.0, sky=True)
    for k in ("diffuse", "specular", "sky"):
        before = look_up(still.nodes, getattr(still, k), np.stack([x, y, z], axis=-1))
        after = look_up(maps.nodes, getattr(maps, k), turned)
        assert np.abs(after - before).max() < 4e-3
    spot = RadianceMap(sun(32, 64), np.pi / 2)
    maps = environment_maps(spot, 20.0)
    ahead, left = look_up(maps.nodes, maps.specular, np.array([[0, 0, -1.0], [-1.0, 0, 0]]))
    assert np.all(left > 100.0 * ahead)


@pytest.mark.slow
def test_a_large_map_is_averaged_by_area():
    rows = LARGEST_ROWS + 180
    texels = np.repeat(smooth(texel_directions(rows))[..., :1], 3, axis=2).astype(np.float32)
    maps = environment_maps(RadianceMap(texels), 20.0, sky=True)
    directions = sphere(2000)
    error = look_up(maps.nodes, maps.sky, directions) - smooth(directions)[:, :1]
    assert np.abs(error).max() < np.pi / LARGEST_ROWS / 8
    assert maps.nodes.nbytes < 72e6


# --- on devices


@pytest.mark.parametrize("lanes", [1, 16])
def test_a_device_looks_up_what_its_twin_does(context, lanes):
    rng = np.random.default_rng(7)
    places = [MapPlace(65, 0), MapPlace(3, 65 * 65), MapPlace(241, 65 * 65 + 9)]
    nodes = rng.random((65 * 65 + 9 + 241 * 241, 4), dtype=np.float32)
    directions = _awkward_directions()
    for place in places:
        got = _on_device(context, lanes, nodes, place, directions)
        expected = look_up(nodes, place, directions.astype(np.float64))
        # u is right to 3e-7; values of neighbours differ by up to 1. Both sides of an edge of these
        # random nodes differ, so a direction on it may get either.
        assert np.abs(got - expected)[:-200].max() < 3e-7 * place.size + 1e-6


@pytest.mark.parametrize("lanes", [1, 16])
def test_no_direction_shows_a_seam(context, lanes):
    """Directions 1e-3 apart across the edges, the diagonals and the poles: no jump beyond the
    slope."""
    texels = smooth(texel_directions()).astype(np.float32)
    maps = environment_maps(RadianceMap(texels), 20.0, sky=True)
    directions = _awkward_directions()
    beside = directions + np.float32(5e-4) * np.roll(sphere(1, 9)[0].astype(np.float32), 1)
    for place in (maps.diffuse, maps.specular, maps.sky):
        here = _on_device(context, lanes, maps.nodes, place, directions)
        there = _on_device(context, lanes, maps.nodes, place, beside)
        assert np.abs(here - there).max() < 2e-3
        exact = look_up(maps.nodes, place, directions.astype(np.float64))
        assert np.abs(here - exact).max() < 2e-6


@pytest.mark.parametrize("lanes", [1, 16])
def test_a_constant_is_exact_and_no_direction_is_finite_too(context, lanes):
    color = np.array([0.3, 1.7, 12345.0], np.float32)
    maps = environment_maps(RadianceMap(np.broadcast_to(color, (16, 32, 3)).copy()), 20.0)
    directions = _awkward_directions()
    directions[:8] = [[0, 0, 0], [np.nan] * 3, [np.inf, 0, 1], [0, np.nan, 0], [-np.inf] * 3,
                      [1e-30, 0, 0], [1e30, -1e30, 0], [-0.0, -0.0, -0.0]]  # fmt: skip
    for place in (maps.diffuse, maps.specular):
        assert np.all(_on_device(context, lanes, maps.nodes, place, directions) == color)


def _awkward_directions() -> np.ndarray:
    """float32 [n, 3], n a multiple of 16: all over the sphere, then around poles, axes and edges;
    the last 200 lie on or next to the square's edges."""
    rng = np.random.default_rng(11)
    axes = np.repeat(np.concatenate([np.eye(3), -np.eye(3)]), 50, axis=0)
    axes[::2] += rng.normal(scale=1e-4, size=(150, 3))
    equator = sphere(100)
    equator[:, 1] = rng.normal(scale=1e-5, size=100)
    edges = sphere(200)  # x = 0 or z = 0 below the equator
    edges[:, 1] = -np.abs(edges[:, 1])
    edges[np.arange(200), 2 * (np.arange(200) % 2)] = rng.normal(scale=1e-5, size=200) * (
        np.arange(200) % 4 > 1
    )
    lower = axes[axes[:, 1] < -0.5]
    axes = axes[axes[:, 1] > -0.5]
    filler = sphere(2016 - (len(axes) + len(lower) + 300) % 16)
    directions = np.concatenate([filler, axes, equator, lower, edges])
    return (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)


def _on_device(context, lanes, nodes, place, directions) -> np.ndarray:
    """float32 [n, 3]."""
    n = len(directions)
    kernel = context.kernel(
        str(SOURCE), "look_up",
        (
            reads("map", np.float32), value("offset", np.int32), value("size", np.int32), value("n", np.int32),
            *(reads(axis, np.float32, "n") for axis in "xyz"), writes("radiance", np.float32, 3, "n"),
        ),
        {"LANES": lanes},
    )  # fmt: skip
    radiance = context.empty(np.float32, (3, n))
    kernel(
        context.queue, (n // lanes,), (1,), map=context.upload(nodes), offset=place.offset,
        size=place.size, n=n, radiance=radiance,
        **{name: context.upload(directions[:, k]) for k, name in enumerate("xyz")},
    )  # fmt: skip
    return context.read(radiance).T


# --- files


@pytest.mark.parametrize("face, direction, right, down", [
    (0, (1, 0, 0), (0, 0, -1), (0, -1, 0)), (1, (-1, 0, 0), (0, 0, 1), (0, -1, 0)),
    (2, (0, 1, 0), (1, 0, 0), (0, 0, 1)), (3, (0, -1, 0), (1, 0, 0), (0, 0, -1)),
    (4, (0, 0, 1), (1, 0, 0), (0, -1, 0)), (5, (0, 0, -1), (-1, 0, 0), (0, -1, 0))])  # fmt: skip
def test_a_cubes_faces_lie_as_opengl_has_them(tmp_path, face, direction, right, down):
    """A bright quarter of one face, that of small s and t, shows towards its own corner alone."""
    strip = np.zeros((6 * 32, 32, 3), np.float32)
    strip[32 * face : 32 * face + 16, :16] = 1.0
    radiance = load_radiance(write_exr(tmp_path / "cube.exr", strip), "cube")
    maps = environment_maps(radiance, 1e9)
    direction, right, down = (np.array(v, float) for v in (direction, right, down))
    quarters = [(-1, -1), (1, -1), (-1, 1), (1, 1)]
    corners = [direction + 0.5 * (a * right + b * down) for a, b in quarters]
    got = look_up(maps.nodes, maps.specular, np.array([*corners, -direction]))[:, 0]
    assert np.allclose(got, [1, 0, 0, 0, 0], atol=1e-6)


def test_cube_coordinates_and_directions_are_inverse():
    rng = np.random.default_rng(2)
    s, t = rng.random(500), rng.random(500)
    for face in range(6):
        there, u, v = cube_coordinates(cube_directions(face, s, t))
        assert np.all(there == face) and np.allclose(u, s) and np.allclose(v, t)


def test_a_cube_and_latitude_and_longitude_show_the_same(tmp_path):
    n = 48
    centre = (np.arange(n) + 0.5) / n
    faces = [cube_directions(k, centre[None, :], centre[:, None]) for k in range(6)]
    strip = np.concatenate(faces)
    strip = smooth(strip / np.linalg.norm(strip, axis=-1, keepdims=True))
    cube = load_radiance(write_exr(tmp_path / "cube.exr", strip), "cube")
    latlong = load_radiance(write_exr(tmp_path / "map.exr", smooth(texel_directions(2 * n))))
    assert cube.texels.shape == latlong.texels.shape == (2 * n, 4 * n, 3)
    # At a face's edge the border is the neighbour's nearest texel: off by up to half a texel, 1/n.
    assert np.abs(cube.texels - latlong.texels).max() < 1.0 / n
    assert np.abs(cube.texels - latlong.texels).mean() < 1e-3
    directions = sphere(2000)
    of_cube, of_map = environment_maps(cube, 20.0), environment_maps(latlong, 20.0)
    for k in ("diffuse", "specular"):
        difference = look_up(of_cube.nodes, getattr(of_cube, k), directions) - look_up(
            of_map.nodes, getattr(of_map, k), directions
        )
        assert np.abs(difference).max() < 1e-3


def ball_directions(n: int) -> np.ndarray:
    """float64 [n, n, 3]: what the texels of a mirror ball show; 0 around it."""
    at = (np.arange(n) + 0.5) * 2 / n - 1
    v, u = np.meshgrid(-at, at, indexing="ij")
    nz = np.sqrt(np.maximum(1 - u * u - v * v, 0))
    return np.stack([2 * nz * u, 2 * nz * v, 2 * nz * nz - 1], axis=-1) * (u * u + v * v <= 1)[..., None]


def test_a_mirror_ball_and_latitude_and_longitude_show_the_same(tmp_path):
    n = 96
    square = smooth(ball_directions(n))
    square[~ball_directions(n).any(axis=-1)] = np.nan  # not read
    ball = load_radiance(write_exr(tmp_path / "ball.exr", square), "sphere")
    latlong = load_radiance(write_exr(tmp_path / "map.exr", smooth(texel_directions(n))))
    assert ball.texels.shape == latlong.texels.shape == (n, 2 * n, 3)
    apart = np.abs(ball.texels - latlong.texels)
    # Around -z a ring of texels is all there is: a texel less of the disc is an angle of 2 / sqrt(n).
    assert apart[:, np.abs(np.arange(2 * n) + 0.5 - n) > n / 4].max() < 0.02 and apart.mean() < 0.01
    assert apart.max() < 2.0 / np.sqrt(n)
    directions = sphere(2000)
    of_ball, of_map = environment_maps(ball, 20.0), environment_maps(latlong, 20.0)
    for k in ("diffuse", "specular"):
        difference = look_up(of_ball.nodes, getattr(of_ball, k), directions) - look_up(
            of_map.nodes, getattr(of_map, k), directions
        )
        assert np.abs(difference).max() < 0.01


@pytest.mark.parametrize("u, v, direction", [
    (0, 0, (0, 0, 1)), (np.sqrt(0.5), 0, (1, 0, 0)), (0, np.sqrt(0.5), (0, 1, 0)), (-np.sqrt(0.5), 0, (-1, 0, 0)),
    (0.6, 0.8, (0, 0, -1)),
])  # fmt: skip
def test_a_mirror_ball_shows_its_surroundings_as_opengl_has_them(u, v, direction):
    got = ball_coordinates(np.array(direction, float))
    if direction == (0, 0, -1):
        assert np.hypot(*got) == pytest.approx(1.0)
    else:
        assert got == pytest.approx((u, v), abs=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_mirror_ball_of_few_texels(tmp_path, n):
    """One texel is the same light from everywhere."""
    radiance = load_radiance(write_exr(tmp_path / "ball.exr", np.full((n, n, 3), 0.5)), "sphere")
    np.testing.assert_allclose(radiance.texels, 0.5, atol=1e-6)
    maps = environment_maps(radiance, 10.0)
    np.testing.assert_allclose(look_up(maps.nodes, maps.diffuse, sphere(50)), 0.5, atol=1e-5)


def test_a_texel_of_a_cube_keeps_its_energy(tmp_path):
    """A sun of one texel, at faces' centres, edges and corners: its solid angle within 15 %."""
    n = 32
    for face, row, column in ((5, 16, 16), (0, 0, 16), (2, 0, 0), (4, 31, 31)):
        strip = np.zeros((6 * n, n, 3), np.float32)
        strip[face * n + row, column] = 1e4
        radiance = load_radiance(write_exr(tmp_path / "cube.exr", strip), "cube")
        centre = cube_directions(face, np.array((column + 0.5) / n), np.array((row + 0.5) / n))
        expected = 1e4 * (2.0 / n) ** 2 / np.linalg.norm(centre) ** 3
        ring = -np.diff(np.cos(np.linspace(0.0, np.pi, 2 * n + 1))) * 2.0 * np.pi
        got = (radiance.texels[..., 0].mean(axis=1) * ring).sum()
        assert got == pytest.approx(expected, rel=0.15)


def test_intensity_is_a_factor_and_half_floats_are_read(tmp_path):
    plain = load_radiance(STUDIO)
    bright = load_radiance(STUDIO, intensity=2.5, rotation_degrees=90.0)
    assert plain.texels.shape == (64, 128, 3) and plain.texels.dtype == np.float32
    assert np.array_equal(bright.texels, plain.texels * np.float32(2.5))
    assert plain.rotation == 0.0 and bright.rotation == pytest.approx(np.pi / 2)
    rgba = np.dstack([plain.texels, np.full((64, 128, 1), 0.5, np.float32)])
    path = write_exr(tmp_path / "rgba.exr", RGBA=rgba)
    assert np.array_equal(load_radiance(path).texels, plain.texels)


def _broken(kind: str, tmp_path: Path) -> tuple[Path, str]:
    """A file that cannot be used, and the layout that it is given as."""
    path = tmp_path / "bad.exr"
    good = np.full((8, 16, 3), 0.5, np.float32)
    if kind == "text":
        path.write_text("no picture")
    elif kind == "cut off":
        whole = write_exr(path, noise(32)).read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
    elif kind == "no header":
        path.write_bytes(b"\x76\x2f\x31\x01")
    elif kind == "grey":
        write_exr(path, Y=good[..., 0])
    elif kind == "latlong":
        write_exr(path, good[:, :15])
    elif kind == "sphere":
        write_exr(path, good)
    elif kind in ("cube", "cross"):
        write_exr(path, np.ones((48, 9, 3)) if kind == "cube" else np.ones((32, 24, 3)))
    elif kind == "bad texels":
        good[0, 0], good[1, 1, 2], good[2, 2, 0] = np.nan, np.inf, -1.0
        write_exr(path, good)
    elif kind == "folder":
        path.mkdir()
    return path, {"cube": "cube", "cross": "cube", "sphere": "sphere"}.get(kind, "latlong")


@pytest.mark.parametrize("kind, what", [
    ("missing", "No such file"), ("folder", "cannot be read"), ("text", "is not an OpenEXR file"),
    ("cut off", "cannot be read"), ("no header", "cannot be read"), ("grey", "the channels are Y"),
    ("latlong", "15 x 8 texels"), ("cube", "9 x 48 texels"), ("cross", "24 x 32 texels"),
    ("sphere", "16 x 8 texels"),
    ("bad texels", "3 of 128 texels are negative or not finite")])  # fmt: skip
def test_a_file_that_is_wrong_is_one_line(tmp_path, kind, what):
    path, layout = _broken(kind, tmp_path)
    with pytest.raises(SceneError) as error:
        load_radiance(path, layout)
    assert str(error.value).startswith(str(path)) and what in str(error.value)
    assert "expected" in str(error.value) and "\n" not in str(error.value)


def test_an_intensity_beyond_float32_is_an_error():
    with pytest.raises(SceneError, match="overflows"):
        load_radiance(STUDIO, intensity=1e38)


def test_the_studio_is_what_its_script_makes():
    import importlib.util

    spec = importlib.util.spec_from_file_location("studio", STUDIO.with_suffix(".py"))
    studio = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(studio)
    assert np.array_equal(load_radiance(STUDIO).texels, studio.studio().astype(np.float16))
