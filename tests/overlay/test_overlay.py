"""What is drawn over a picture: lengths, directions, edges and colours are those of the data, at any size."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clvol import Camera, Isosurface, Overlay, Scene, TransferFunction, Volume
from clvol.overlay import DrawnOverlay
from clvol.overlay.box import EDGES, facing, projected
from clvol.overlay.canvas import Canvas
from clvol.overlay.description import describe_overlay
from clvol.overlay.orientation import edge_names
from clvol.overlay.scale import bar_length, number, pixels_per_length, ticks

TURNED = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
ALL = dict(scale_bar=True, color_bar=True, orientation="letters", box=True, title="A title", caption="A caption")


def volume(**keys):
    data = np.arange(4 * 5 * 6, dtype=np.uint8).reshape(4, 5, 6)
    return Volume(data, **{"spacing": (2.0, 3.0, 4.0), "origin": (5.0, -7.0, 11.0), "direction": TURNED, **keys})


def described(camera=None, grid=None, **overlay):
    scene = Scene(
        volume=volume(**(grid or {})),
        camera=camera,
        overlay=overlay,
        transfer_function=TransferFunction([10, 90], [0, 0.5], [[1, 0, 0], [0, 0, 1]]),
    ).resolve()
    return describe_overlay(scene, scene.camera)


def drawn(shape=(120, 160), shade=0.0, dtype=np.uint8, channels=3, description=None, **overlay):
    picture = np.full((*shape, channels), round(shade * np.iinfo(dtype).max), dtype)
    overlay = overlay or ALL
    own = description or described(**overlay)
    return picture, DrawnOverlay(own).drawn_over(picture, np.zeros(shape))


# --- lengths


@pytest.mark.parametrize(
    ("largest", "unit", "length", "name"),
    [
        (60, "mm", 50, "50 mm"), (0.3, "mm", 0.2, "200 µm"), (3000, "µm", 2000, "2 mm"), (1234, "mm", 1000, "1 m"),
        (12, None, 10, "10 units"), (7, "Å", 5, "5 Å"), (9, "pixel", 5, "5 pixel"), (99.99, "mm", 50, "50 mm"),
        (1e-7, None, 1e-7, "1e−07 units"), (2.0, "furlong", 2, "2 furlong"),
    ],
)  # fmt: skip
def test_the_bar_has_a_round_length_with_its_unit(largest, unit, length, name):
    found, told = bar_length(largest, unit)
    assert told == name and found == pytest.approx(length)


def test_an_orthographic_pixel_is_the_same_length_everywhere():
    camera = Camera(projection="orthographic", position=(0, 0, 9), target=(0, 0, 0), up=(0, 1, 0), height=50.0)
    assert pixels_per_length(camera, 200) == 4.0


def test_a_perspective_length_is_that_at_the_target():
    camera = Camera(position=(3, 4, 12), target=(0, 0, 0), up=(0, 1, 0), fov_degrees=40)
    _, right, _ = camera.basis()
    ends = np.array([np.zeros(3), 2.0 * right])
    line = projected(ends, camera, 300, 200)
    assert math.dist(*line) == pytest.approx(2.0 * pixels_per_length(camera, 200))


@pytest.mark.parametrize("height", [100, 240, 777])
def test_the_drawn_bar_is_as_long_as_it_says(height):
    camera = {"projection": "orthographic", "height": 60.0}
    description = described(camera, {"unit": "mm"}, scale_bar=True, color=(1, 0, 0))
    shape = (height, round(1.4 * height))
    _, picture = drawn(shape, 0.5, description=description)
    red = (picture[..., 0] > 250) & (picture[..., 1] < 140)
    longest = max(np.count_nonzero(row) for row in red)  # a pixel that is covered by half counts
    assert bar_length(0.24 * shape[1] / (height / 60.0), "mm") == (20.0, "20 mm")
    assert longest == pytest.approx(20.0 * height / 60.0, abs=1.0)


@pytest.mark.parametrize("seed", range(20))
def test_ticks_are_round_and_within_the_range(seed):
    random = np.random.default_rng(seed)
    low = float(random.normal() * 10.0 ** random.integers(-6, 6))
    high = low + float(abs(random.normal()) * 10.0 ** random.integers(-6, 6))
    for most in (2, 3, 5):
        found = ticks(low, high, most)
        assert 0 < len(found) <= most and found == sorted(found)
        assert all(low - 1e-6 * (high - low) <= value <= high + 1e-6 * (high - low) for value in found)


def test_numbers_have_a_true_minus():
    assert number(-1024) == "\u22121024" and number(0) == "0" and number(2.5e-7) == "2.5e\u221207"


# --- directions


@pytest.mark.parametrize(
    ("view", "names"),
    [
        ("front", dict(right="L", left="R", top="S", bottom="I")),
        ("back", dict(right="R", left="L", top="S", bottom="I")),
        ("left", dict(right="P", left="A", top="S", bottom="I")),
        ("top", dict(right="R", left="L", top="P", bottom="A")),
        ("bottom", dict(right="L", left="R", top="A", bottom="P")),
    ],
)
@pytest.mark.parametrize("frame", ["LPS", "RAS"])
def test_letters_are_the_patient_s_sides(view, names, frame):
    """As radiologists see them: from the front, the patient's left is at the right of the picture."""
    grid = {"frame": frame, "direction": np.eye(3)}
    known = edge_names(described({"view": view}, grid))
    if view == "top":  # which way the head is turned is the view's own choice
        assert {known["top"], known["bottom"]} == {"A", "P"} and {known["left"], known["right"]} == {"L", "R"}
    else:
        assert known == names


def test_letters_agree_with_where_voxels_are_drawn():
    """A letter at the right names the direction in which positions move to the right."""
    description = described({"view": "front-left"}, {"frame": "LPS"})
    names = edge_names(description)
    camera, centre = description.camera, np.array(description.corners).mean(axis=0)
    for side, (axis, sign) in {"right": (0, 1), "left": (0, -1), "top": (1, -1), "bottom": (1, 1)}.items():
        letter = names[side][0]
        direction = np.array(description.axes)[
            description.names.index(letter) if letter in description.names else description.opposites.index(letter)
        ] * (1 if letter in description.names else -1)
        line = projected(np.array([centre, centre + direction]), camera, 400, 400)
        assert sign * (line[1][axis] - line[0][axis]) > 0


def test_axes_of_a_frame_that_nobody_knows_are_x_y_z():
    placeholder = {"frame": "LPS", "origin": (0, 0, 0), "direction": np.eye(3)}
    for grid in ({"frame": "index"}, placeholder):
        assert edge_names(described({"view": "front"}, grid))["right"][1] in "xyz"
    assert edge_names(described({"position": (0, 0, 99), "target": (0, 0, 0)}))["top"] == "+y"


def test_directions_between_two_axes_name_both():
    names = edge_names(described({"view": "front-left"}, {"frame": "LPS"}))
    assert set(names["right"]) == {"L", "P"} and names["top"] == "S"


# --- the box


@pytest.mark.parametrize("projection", ["orthographic", "perspective"])
def test_corners_are_drawn_where_rays_meet_them(projection):
    description = described({"projection": projection})
    camera, width, height = description.camera, 90, 70
    origins, directions = camera.world_rays(width, height)
    for a, b in EDGES:
        corners = np.array(description.corners)[[a, b]]
        for corner, (x, y) in zip(corners, projected(corners, camera, width, height)):
            origin, direction = origins[int(y), int(x)], directions[int(y), int(x)]
            away = corner - origin
            off = np.linalg.norm(away - (away @ direction) * direction)
            assert off * pixels_per_length(camera, height) < 1.5


def test_three_faces_are_turned_towards_an_oblique_view_and_one_towards_a_straight_one():
    oblique = described({"projection": "orthographic"})
    assert sum(facing(np.array(oblique.corners), oblique.camera).values()) == 3
    inside = described({"position": (8.0, 0.0, 17.0), "target": (9.0, 1.0, 17.5)})
    assert sum(facing(np.array(inside.corners), inside.camera).values()) == 0


def test_what_is_behind_the_eye_is_cut_off():
    camera = Camera(position=(0, 0, 10), target=(0, 0, 0), up=(0, 1, 0))
    assert projected(np.array([[0, 0, 11], [1, 0, 12.0]]), camera, 100, 100) is None
    (x0, y0), (x1, y1) = projected(np.array([[0, 0, 0], [0.1, 0, 20.0]]), camera, 100, 100)
    assert (x0, y0) == (50, 50) and x1 > 50 and y1 == 50


def test_the_volume_covers_edges_behind_it_alone():
    description = described({"projection": "orthographic"}, box=True, color=(1, 1, 1))
    shape = (200, 200)
    empty = DrawnOverlay(description).drawn_over(np.zeros((*shape, 3), np.uint8), np.zeros(shape))
    full = DrawnOverlay(description).drawn_over(np.zeros((*shape, 3), np.uint8), np.ones(shape))
    assert (full <= empty).all() and full.max() == 255
    lost = np.count_nonzero((empty > full).any(axis=2))
    assert 0.1 < lost / np.count_nonzero(empty.any(axis=2)) < 0.5  # three of twelve edges


# --- the colour bar


def test_the_histogram_and_the_points_are_in_values():
    data = np.zeros((8, 8, 8), np.int16)
    data[2:6, 2:6, 2:6] = 100
    scene = Scene(volume=Volume(data, slope=2.0, offset=-1000.0), overlay=Overlay(color_bar=True),
                  transfer_function=TransferFunction([-900.0, -800.0], [0, 1], np.ones((2, 3))),
                  isosurface=[Isosurface(value=-850.0)]).resolve()  # fmt: skip
    found = describe_overlay(scene, scene.camera)
    assert found.values == (-900.0, -800.0) and found.surfaces[0].value == -850.0
    assert (found.low, found.high) == (-1000.0, -800.0)
    assert found.counts[0] == 448 and found.counts[-1] == 64 and sum(found.counts) == 512


@pytest.mark.parametrize("data", [np.zeros((3, 3, 3)), np.full((3, 3, 3), np.nan), np.ones((1, 1, 1), np.uint8)])
def test_volumes_without_a_range_are_drawn(data):
    scene = Scene(volume=Volume(data), overlay=ALL).resolve()
    description = describe_overlay(scene, scene.camera)
    before, after = drawn(description=description)
    assert not np.array_equal(before, after)


def test_the_colours_are_those_of_the_function():
    description = described(color_bar=True)
    _, picture = drawn((400, 400), 0.5, description=description)
    reds = (picture[..., 0] > 250) & (picture[..., 1:] < 5).all(axis=2)
    blues = (picture[..., 2] > 250) & (picture[..., :2] < 5).all(axis=2)
    assert reds.sum() > 20 and blues.sum() > 20
    assert np.nonzero(reds)[1].max() < np.nonzero(blues)[1].min()


# --- drawing


@pytest.mark.parametrize("shade", [0.0, 0.3, 0.5, 0.7, 1.0])
@pytest.mark.parametrize("part", ["title", "caption", "scale_bar", "letters", "box"])
def test_everything_can_be_read_on_any_background(shade, part):
    settings = {"title": {part: "Text"}, "caption": {part: "Text"}, "letters": {"orientation": part}}
    before, after = drawn((200, 260), shade, description=described(**settings.get(part, {part: True})))
    contrast = np.abs(after.astype(int) - before).max(axis=2)
    assert np.count_nonzero(contrast > 80) > 15


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (40, 300), (300, 40), (400, 500)])
def test_any_size_and_kind_of_picture_is_drawn_on(shape, channels, dtype):
    before, after = drawn(shape, 0.0, dtype, channels)
    assert after.shape == before.shape and after.dtype == before.dtype and not before.any()
    if min(shape) > 30:
        assert after.any()


def test_sizes_are_relative_to_the_picture():
    small, large = (drawn(shape, title="Title")[1] > 128 for shape in ((300, 400), (1200, 1600)))
    assert large.mean() == pytest.approx(small.mean(), rel=0.15)


def test_without_settings_nothing_is_touched():
    before, after = drawn(description=described())
    assert after is before


def test_sixteen_bits_are_drawn_on_as_eight_are():
    eight, sixteen = drawn(dtype=np.uint8)[1], drawn(dtype=np.uint16)[1]
    assert np.abs(sixteen / 257.0 - eight).max() < 4  # rounding, once for each part that lies above another


def test_text_over_transparency_is_opaque():
    picture = drawn((100, 200), 0.0, np.uint8, 4, title="Title")[1]
    assert picture[..., 3].max() == 255 and picture[-20:, :, 3].max() == 0


@pytest.mark.parametrize(
    "text", ["", "$x_2$ \\frac", "a\x1b[31m\u202eb", "x" * 2000, "a b " * 500, "Ä µ α 中", "a\nb\n"]
)
def test_any_text_is_drawn_as_it_is(text):
    before, after = drawn((150, 200), description=described(title=text, caption=text))
    assert after.shape == before.shape


def test_lines_are_as_wide_as_they_should_be():
    canvas = Canvas(np.zeros((60, 60, 3), np.uint8))
    canvas.strokes([((10.0, 10.0), (50.0, 40.0))], 3.0, (1, 1, 1))
    assert canvas.picture[..., 0].sum() / 255 == pytest.approx(3.0 * 50.0 + math.pi * 1.5**2, rel=0.03)
    canvas.strokes([((-1e6, 5.0), (1e6, 5.0))], 1.0, (1, 0, 0))
    assert (canvas.picture[4:6, :, 0].astype(int).sum(axis=0) > 200).all()


def test_an_overlay_comes_back_from_json():
    overlay = DrawnOverlay(described(**ALL, size=1.5, color=(0.1, 0.2, 0.3), value_label="HU"))
    assert DrawnOverlay.from_json(overlay.to_json()).description == overlay.description


def test_pictures_have_the_overlay_and_light_does_not(tmp_path):
    from clvol.image import load_image
    from clvol.render.frame import make_frame

    frames = {}
    for name, overlay in (("with", ALL), ("without", {})):
        scene = Scene(volume=volume(), overlay=overlay).resolve()
        frames[name] = make_frame(scene, np.zeros((90, 120, 4)), None, {}, {}, [])
        for ending in ("png", "jpg", "tif", "exr", "npy"):
            frames[name].save(tmp_path / f"{name}.{ending}")
    for ending in ("png", "jpg", "tif", "exr", "npy"):
        one, other = (load_image(tmp_path / f"{name}.{ending}")["rgba"] for name in frames)
        assert np.array_equal(one, other) == (ending in ("exr", "npy"))
    assert np.array_equal(np.asarray(frames["with"].image()), np.asarray(_opened(tmp_path / "with.png")))


def _opened(path):
    from PIL import Image

    return Image.open(path)
