"""volume.slope and volume.offset label the axis of values: pictures are those of the same scene said
in stored numbers, whatever speaks of values."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import rms, waves

import clvol
from clvol.cli import main
from clvol.explanation import explain
from clvol.scene import load_scene
from clvol.volume import Volume
from clvol.volume.axis import ValueAxis, turned

STORED = waves((17, 15, 19), np.uint8)
LABELS = np.repeat(np.arange(17, dtype=np.int16)[:, None, None], 15, axis=1).repeat(19, axis=2)
PLAIN = ValueAxis()
# Powers of two and whole offsets: nothing is rounded on the way, so pictures agree to the bit.
AXES = [ValueAxis(1.0, -1000.0), ValueAxis(0.25, 3.0), ValueAxis(-2.0, 70.0)]
TYPES = ["uint8", "int8", "uint16", "int16", "float32", "float64"]


def tables(axis: ValueAxis, volume: Volume, **parts) -> dict:
    """A scene said in values of ``axis``; ``effects``: with all else that is stated in values."""
    gain = abs(axis.slope)

    def points(*stored: float) -> list[dict]:
        said = [
            {"value": axis.values(v), "opacity": a, "color": [0.9, v / 255, 0.3]}
            for v, a in zip(stored, (0.0, 0.15, 0.4, 0.02))
        ]
        return sorted(said, key=lambda point: point["value"])

    scene = {
        "volume": volume,
        "transfer_function": {"points": points(20, 90, 160, 240)},
        "image": {"width": 20, "height": 16},
        "integration": {"early_termination": 0.0},
    }
    if parts.pop("effects", False):
        scene |= {
            "light": [{"type": "headlight"}],
            "material": {"fade": 3.0 * gain},
            "isosurface": [{"value": axis.values(130.0), "opacity": 0.6}],
            "gradient_opacity": {
                "points": [
                    {"magnitude": 0.0, "opacity": 0.2},
                    {"magnitude": 20.0 * gain, "opacity": 1.0},
                ]
            },
            "directional_opacity": {
                "points": [
                    {"derivative": 0.0, "opacity": 0.5},
                    {"derivative": 15.0 * gain, "opacity": 1.0},
                ]
            },
            "transfer_layer": [{"magnitude": 12.0 * gain, "points": points(40, 120, 200)}],
            "noise": [
                {"target": "value", "amplitude": 6.0 * gain, "frequency": 0.2},
                {"target": "fur", "amplitude": 3.0, "root": axis.values(160.0), "tip": axis.values(60.0)},
            ],
        }
    return scene | parts


def labelled(stored: np.ndarray, axis: ValueAxis) -> Volume:
    return Volume(stored, slope=axis.slope, offset=axis.offset)


def as_plain(stored: np.ndarray, axis: ValueAxis) -> tuple[np.ndarray, ValueAxis]:
    """The stored numbers that rise with the values, and their axis."""
    if axis.slope > 0:
        return stored, axis
    return turned(stored, stored.dtype), axis.turned(stored.dtype)


def renderings(one: dict, other: dict, device) -> tuple[np.ndarray, np.ndarray]:
    pictures = []
    for scene in (one, other):
        with clvol.Renderer(clvol.Scene(**scene), devices=[device]) as renderer:
            pictures.append(renderer.render().rgba)
    return tuple(pictures)


def said_in_stored(axis: ValueAxis, stored: np.ndarray, **parts) -> tuple[dict, dict]:
    """The scene said in values, and the same said in the numbers that are stored."""
    numbers, plain_axis = as_plain(stored, axis)
    one = tables(axis, labelled(stored, axis), **parts)
    other = tables(PLAIN, Volume(numbers), **parts)

    def in_stored(value: float) -> float:
        return float(plain_axis.stored(value))

    other["transfer_function"] = {
        "points": [
            {**point, "value": in_stored(point["value"])}
            for point in one["transfer_function"]["points"]
        ]
    }
    for k, layer in enumerate(one.get("transfer_layer", ())):
        other["transfer_layer"][k]["points"] = [
            {**point, "value": in_stored(point["value"])} for point in layer["points"]
        ]
    for k, noise in enumerate(one.get("noise", ())):
        ends = {key: in_stored(noise[key]) for key in ("root", "tip") if key in noise}
        other["noise"][k] = {**other["noise"][k], **ends}
    for k, surface in enumerate(one.get("isosurface", ())):
        other["isosurface"][k] = {**surface, "value": in_stored(surface["value"])}
    return one, other


@pytest.mark.parametrize(
    "method, axis",
    [
        *(("raycast", axis) for axis in AXES),
        *((method, AXES[2]) for method in ("multiresolution", "pyramid", "reference")),
    ],
)
def test_every_method_shows_the_same_picture(device, method, axis) -> None:
    settings = {"method": method, "early_termination": 0.0}
    one, other = said_in_stored(axis, STORED, integration=settings)
    found, wanted = renderings(one, other, device)
    assert found[..., 3].max() > 0.1
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.slow
@pytest.mark.parametrize("axis", AXES[2:])
def test_all_effects_that_speak_of_values(device, axis) -> None:
    found, wanted = renderings(*said_in_stored(axis, STORED, effects=True), device)
    assert found[..., 3].max() > 0.1
    np.testing.assert_allclose(found, wanted, atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "dtype, compositing",
    [("uint8", "minimum"), *((dtype, "maximum") for dtype in ("uint8", "int16", "float32"))],
)
def test_projections_are_of_values_whatever_the_slopes_sign(device, dtype, compositing) -> None:
    """The highest value of a falling axis is the lowest number stored; beside the values themselves
    as voxels."""
    stored = (STORED.astype(np.float64) / 2).astype(dtype)
    axis = ValueAxis(-3.0, 500.0)
    values = axis.values(stored.astype(np.float64))
    points = [
        {"value": float(values.min()), "opacity": 0.0, "color": [0, 0, 0]},
        {"value": float(values.max()), "opacity": 1.0, "color": [1, 1, 1]},
    ]
    parts = {
        "transfer_function": {"points": points},
        "integration": {"compositing": compositing},
        "image": {"width": 12, "height": 10},
    }
    one = {"volume": labelled(stored, axis), **parts}
    other = {"volume": Volume(values.astype(np.float32)), **parts}
    found, wanted = renderings(one, other, device)
    assert np.ptp(wanted[..., 3]) > 0.1
    np.testing.assert_allclose(found, wanted, atol=3e-3)


@pytest.mark.parametrize("dtype, slope", [("uint8", 0.5), *((dtype, -0.5) for dtype in TYPES[1:])])
def test_values_mean_what_voxels_converted_beforehand_mean(device, dtype, slope) -> None:
    """The exact integrals of both agree: by no path of our own but the voxels."""
    stored = (STORED.astype(np.float64) / 2).astype(dtype)
    axis = ValueAxis(slope, -20.0)
    parts = {"integration": {"method": "reference"}, "image": {"width": 10, "height": 8}}
    one = tables(axis, labelled(stored, axis), **parts)
    other = {**one, "volume": Volume(axis.values(stored.astype(np.float64)).astype(np.float32))}
    found, wanted = renderings(one, other, device)
    assert found[..., 3].max() > 0.05
    assert rms(found, wanted) < 1e-5


def test_a_function_set_later_is_of_values_too(device) -> None:
    axis = AXES[2]
    scene = clvol.Scene(**tables(axis, labelled(STORED, axis)))
    function = scene.resolve().axis  # of stored numbers; the function below is of values
    with clvol.Renderer(scene, devices=[device]) as renderer:
        before = renderer.render().rgba
        values = [axis.values(v) for v in (240, 160, 90, 20)]
        other = clvol.TransferFunction(values, [0.5, 0.3, 0.0, 0.0], np.full((4, 3), 0.5))
        renderer.set_transfer_function(other)
        later = renderer.render().rgba
    with clvol.Renderer(
        scene.model_copy(update={"transfer_function": other}), devices=[device]
    ) as renderer:
        np.testing.assert_array_equal(later, renderer.render().rgba)
    assert rms(before, later) > 1e-3 and function.slope > 0


@pytest.mark.slow
@pytest.mark.parametrize("role", ["label", "density", "mask"])
@pytest.mark.parametrize("axis", [AXES[0], AXES[2]])
def test_fields_have_values_of_their_own(device, axis, role) -> None:
    numbers, plain_axis = as_plain(LABELS, axis)
    scenes = []
    for volume, value in (
        (labelled(LABELS, axis), lambda v: v),
        (Volume(numbers), lambda v: float(plain_axis.stored(v))),
    ):
        low, high = (value(axis.values(v)) for v in ((4, 9) if axis.slope > 0 else (9, 4)))
        field = {"file": volume, "role": role}
        if role == "label":
            field["labels"] = [{"label": int(low), "color": [0.0, 0.2, 1.0], "opacity": 0.5}]
        elif role == "mask":
            field |= {"threshold": low, "keep": "above"}
        else:
            field["points"] = [
                {"value": low, "opacity": 0.0, "color": [1, 0, 0]},
                {"value": high, "opacity": 0.3, "color": [1, 1, 0]},
            ]
        scenes.append({**tables(PLAIN, Volume(STORED)), "field": [field]})
    found, wanted = renderings(*scenes, device)
    np.testing.assert_array_equal(found, wanted)
    without = renderings(tables(PLAIN, Volume(STORED)), scenes[1], device)[0]
    assert rms(found, without) > 1e-3


def test_steps_meet_whole_numbers_that_division_misses(device) -> None:
    """1.1 / 0.1 is not 11: a step at the value 1.1 is at the stored 11 all the same."""
    stored = np.repeat(np.arange(9, 14, dtype=np.uint8), 25).reshape(5, 5, 5)
    axis = ValueAxis(0.1, 0.0)
    resolved = clvol.Scene(
        volume=labelled(stored, axis),
        transfer_function=clvol.TransferFunction(
            [0.0, 1.1, 1.1, 2.0], [0.0, 0.0, 0.5, 0.5], np.ones((4, 3))
        ),
    ).resolve()
    assert resolved.transfer_function.values[1] == 11.0
    assert resolved.transfer_function.opacity(11.0) == 0.5


def test_nan_counts_as_a_value(tmp_path) -> None:
    array = np.array([[[1.0, np.nan], [3.0, 4.0]]] * 2, np.float32)
    np.save(tmp_path / "v.npy", array)
    sets = ["volume.slope=-2.0", "volume.offset=10.0", "volume.nan=20.0"]
    volume = load_scene(tmp_path / "v.npy", sets).load_volume()
    assert volume.value_range == (2.0, 20.0) and volume.nan_count == 0
    assert volume.data[0, 0, 1] == -5.0


def test_ranges_and_reasons_are_told_in_values(tmp_path, capfd) -> None:
    np.save(tmp_path / "v.npy", STORED)
    points = [
        {"value": -1500.0, "opacity": 0.0, "color": [1, 1, 1]},
        {"value": -1200.0, "opacity": 0.0, "color": [1, 1, 1]},
    ]
    axis = ValueAxis(2.0, -1000.0)
    resolved = clvol.Scene(
        volume=labelled(STORED, axis),
        transfer_function={"points": points},
        isosurface=[{"value": 600.0}],
    ).resolve()
    reasons = {e["name"]: e["reason"] for e in explain(resolved)["effects"]}
    said = " ".join(reasons.values())
    assert "-1000 to -490" in said and "iso-value 600 lies" in said
    assert main(["info", str(tmp_path / "v.npy"), "--set", "volume.slope=-1.0"]) == 0
    told = capfd.readouterr().out
    assert "-255 to 0" in told and "-1 * stored + 0" in told


@pytest.mark.slow
@pytest.mark.parametrize("axis", AXES[1:])
def test_a_store_keeps_the_axis(tmp_path, device, axis) -> None:
    np.save(tmp_path / "v.npy", STORED)
    sets = [f"volume.slope={axis.slope}", f"volume.offset={axis.offset}"]
    arguments = [word for text in sets for word in ("--set", text)]
    store = str(tmp_path / "v.zarr")
    assert main(["store", str(tmp_path / "v.npy"), "-o", store, "--quiet", *arguments]) == 0
    volume = clvol.load_volume(store)
    assert (volume.slope, volume.offset) == (axis.slope, axis.offset)
    assert volume.value_range == labelled(STORED, axis).value_range
    assert np.array_equal(volume.data, STORED)
    settings = {"method": "multiresolution", "early_termination": 0.0}
    one = tables(axis, clvol.load_volume(store), integration=settings)
    other = tables(axis, labelled(STORED, axis), integration=settings)
    np.testing.assert_array_equal(*renderings(one, other, device))
    again = clvol.load_volume(store, slope=2.0, offset=1.0)
    assert again.value_range == ValueAxis(2.0, 1.0).span(volume.value_range)


@pytest.mark.parametrize(
    "text", ["slope=0.0", "slope=nan", "slope=1e31", "offset=inf", 'offset="x"']
)
def test_impossible_axes_are_refused(tmp_path, text) -> None:
    np.save(tmp_path / "v.npy", STORED)
    with pytest.raises(clvol.errors.SceneError, match=f"volume.{text.split('=')[0]}: got"):
        load_scene(tmp_path / "v.npy", [f"volume.{text}"])
    with pytest.raises(clvol.errors.VolumeError):
        Volume(STORED, slope=0.0)


@pytest.mark.parametrize("dtype", ["int32", "uint32", "int64", "uint64"])
def test_labels_of_any_integers_are_told_apart(device, tmp_path, dtype) -> None:
    """Neighbours that float32 holds as one; the picture is that of small labels."""
    top = np.iinfo(dtype).max
    numbers = np.array([top // 2**11 - 5, top // 2**11 - 4, top], dtype)
    places = LABELS % 3
    np.save(tmp_path / "large.npy", numbers[places])
    scenes = []
    for file, names in ((str(tmp_path / "large.npy"), numbers), (Volume(places), [0, 1, 2])):
        labels = [
            {"label": int(names[0]), "color": [1.0, 0.1, 0.0], "opacity": 0.6},
            {"label": int(names[1]), "color": [0.0, 0.2, 1.0]},
        ]
        field = {"file": file, "role": "label", "labels": labels}
        scenes.append({**tables(PLAIN, Volume(STORED)), "field": [field]})
    found, wanted = renderings(*scenes, device)
    np.testing.assert_array_equal(found, wanted)
    assert np.ptp(found[..., 0] - found[..., 2]) > 0.05
