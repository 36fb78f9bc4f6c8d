"""Transfer functions of other tools: what is read, what is refused, and that out and in is the same function."""

from __future__ import annotations

import json

import numpy as np
import pytest

from clvol.errors import SceneError, UsageError
from clvol.render.made_from import MadeFrom
from clvol.scene import load_scene
from clvol.transfer import TransferFunction, linear_to_srgb
from clvol.transfer.exchange.files import ENDINGS
from clvol.transfer.exchange.sampled import COLOR_ERROR, OPACITY_ERROR

STEPPED = TransferFunction(
    [-10, 0, 20, 20, 50], [0, 0.2, 0.5, 1, 0], ["red", "#00ff00", "blue", "white", "black"], opacity_unit=2.5
)
SNAP = """\
################################################
# IDX   -R-  -G-  -B-  -A--  VIS MSH  LABEL
################################################
    0     0    0    0        0  0  0    "Clear Label"
    7     0    0  255        1  0  1    "hidden"
    1   255    0    0        1  1  1    "Label 1"
    2     0  255    0      0.5  1  1    "Label 2"
"""


def write(path, content) -> str:
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return str(path)


def preset(**keys) -> dict:
    return {"Name": "p", "ColorSpace": "RGB", "RGBPoints": [0, 0, 0, 0, 1, 1, 1, 1], **keys}


@pytest.mark.parametrize("ending", [".json", ".vp.json", ".vp"])
def test_out_and_in_is_the_same_function(tmp_path, ending):
    STEPPED.save(tmp_path / f"a{ending}")
    again = TransferFunction.from_file(tmp_path / f"a{ending}")
    s = np.linspace(-20.0, 60.0, 4001)
    s = s[np.abs(s - 20.0) > 0.01]
    assert np.abs(again.color(s) - STEPPED.color(s)).max() < 1e-14
    over = 1.0 - np.exp(-STEPPED.extinction(s) * again.opacity_unit)
    assert np.abs(again.opacity(s) - over).max() < (OPACITY_ERROR if ending == ".vp" else 1e-12)
    assert again.opacity_unit == (1.0 if ending == ".vp" else 2.5)
    again.save(tmp_path / f"b{ending}")
    assert TransferFunction.from_file(tmp_path / f"b{ending}") == again


def test_linear_colours_of_paraview_are_linear_in_srgb(tmp_path):
    function = TransferFunction.from_file(write(tmp_path / "a.json", [preset(Points=[0, 0, 0.5, 0, 1, 1, 0.5, 0])]))
    s = np.linspace(0.0, 1.0, 1001)
    assert np.abs(linear_to_srgb(function.color(s)) - s[:, None]).max() < COLOR_ERROR
    assert np.array_equal(function.opacity(s), s)


def test_midpoint_and_sharpness_make_kinks_steps_and_curves(tmp_path):
    points = [0, 0, 0.25, 0, 1, 1, 0.5, 1.0, 2, 0, 0.5, 0.5, 3, 1, 0.5, 0]
    function = TransferFunction.from_file(write(tmp_path / "a.json", preset(Points=points)))
    assert function.opacity([0.125, 0.25, 0.625]).tolist() == [0.25, 0.5, 0.75]  # a kink at the midpoint
    assert function.opacity([1.499, 1.5, 1.501]).tolist() == [1.0, 0.0, 0.0]  # a step
    s = 0.5 * (2 * 0.25) ** 6  # a quarter of the way, pressed towards the middle by 1 + 10 * 0.5
    smooth = 3 * s**2 - 2 * s**3
    assert abs(function.opacity(2.25) - (smooth + 0.5 * (s - smooth))) < OPACITY_ERROR
    assert abs(function.opacity(2.5) - 0.5) < OPACITY_ERROR


def test_values_move_to_a_range_and_opacities_are_replaced(tmp_path):
    path = write(tmp_path / "a.json", preset(RGBPoints=[10, 0, 0, 0, 30, 1, 1, 1]))
    assert TransferFunction.from_file(path).values[[0, -1]].tolist() == [10, 30]
    moved = TransferFunction.from_file(path, (100, 200), opacity=[[0, 0], [0.5, 0], [0.5, 0.8], [1, 0.2]])
    assert moved.values[[0, -1]].tolist() == [100, 200]
    assert moved.opacity([125, 149.99, 150, 200]).tolist() == pytest.approx([0, 0, 0.8, 0.2])
    assert TransferFunction.from_file(path).opacity([10, 20, 30]).tolist() == pytest.approx([0, 0.25, 0.5])


def test_one_of_several_presets_is_named(tmp_path):
    path = write(tmp_path / "a.json", [preset(Name="one"), preset(Name="two", RGBPoints=[5, 1, 0, 0, 6, 1, 0, 0])])
    assert TransferFunction.from_file(path, entry="two").values[0] == 5
    with pytest.raises(SceneError, match=r"2 presets: 'one', 'two', expected transfer_function.entry"):
        TransferFunction.from_file(path)
    with pytest.raises(SceneError, match="entry = 'three' among 2 presets"):
        TransferFunction.from_file(path, entry="three")


def test_indexed_colours_of_paraview_are_labels(tmp_path):
    indexed = {"IndexedColors": [1, 0, 0, 0, 0, 1], "Annotations": ["3", "bone", "5", "skin"], "Name": "l"}
    function = TransferFunction.from_file(write(tmp_path / "a.json", [indexed]))
    assert function.opacity([2, 3, 4, 5, 6]).tolist() == [0, 1, 0, 1, 0]
    assert function.color([3, 5]).tolist() == [[1, 0, 0], [0, 0, 1]]


def test_labels_of_itk_snap_are_steps_around_whole_numbers(tmp_path):
    function = TransferFunction.from_file(write(tmp_path / "a.txt", SNAP))
    assert function.opacity([-3, 0, 0.6, 1, 1.4, 2, 3, 7, 9]).tolist() == [0, 0, 1, 1, 1, 0.5, 0, 0, 0]
    assert function.color([1, 2]).tolist() == [[1, 0, 0], [0, 1, 0]]


def test_a_label_table_goes_to_slicer_and_back(tmp_path):
    function = TransferFunction.from_file(write(tmp_path / "a.ctbl", "# table\n0 air 0 0 0 0\n2 a_b 255 128 0 51\n"))
    function.save(tmp_path / "b.ctbl")
    again = TransferFunction.from_file(tmp_path / "b.ctbl")
    labels = np.arange(-2, 6)
    assert np.array_equal(again.opacity(labels), function.opacity(labels))
    assert again.opacity(2) == 0.2 and np.allclose(again.color(2), function.color(2), atol=1e-15)
    again.save(tmp_path / "c.ctbl")
    assert (tmp_path / "c.ctbl").read_text().split("\n")[1:] == (tmp_path / "b.ctbl").read_text().split("\n")[1:]
    with pytest.raises(SceneError, match="no table of labels"):
        STEPPED.save(tmp_path / "d.ctbl")


def test_a_volume_property_of_slicer_is_read(tmp_path):
    lines = ["1", "1", "0.9", "0.1", "0.2", "10", "8 -3024 0 100 0 200 0.5 3071 0.8", "4 0 1 255 1",
             "12 -3024 0 0 0 100 1 0.5 0 3071 1 1 1"]  # fmt: skip
    function = TransferFunction.from_file(write(tmp_path / "a.vp", "\n".join(lines) + "\n"))
    assert function.opacity([50, 150, 200, 4000]).tolist() == pytest.approx([0, 0.25, 0.5, 0.8])
    assert linear_to_srgb(function.color(100)).tolist() == pytest.approx([1, 0.5, 0])
    assert function.opacity_unit == 1.0


def test_a_colour_table_of_visit_is_read(tmp_path):
    def point(position, colors):
        return (
            f'<Object name="ColorControlPoint"><Field name="colors" type="unsignedCharArray" length="4">{colors} '
            f'</Field><Field name="position" type="float">{position}</Field></Object>'
        )

    head = '<?xml version="1.0"?>\n<Object name="ColorTable"><Object name="ColorControlPointList">'
    content = head + point(0, "255 0 0 0") + point(1, "0 0 255 255") + "{}</Object></Object>"
    function = TransferFunction.from_file(write(tmp_path / "a.ct", content.format("")), (0, 10))
    assert function.opacity([0, 5, 10]).tolist() == pytest.approx([0, 0.5, 1])
    assert linear_to_srgb(function.color(5)).tolist() == pytest.approx([0.5, 0, 0.5], abs=COLOR_ERROR)
    discrete = '<Field name="discrete" type="bool">true</Field>'
    function = TransferFunction.from_file(write(tmp_path / "b.ct", content.format(discrete)), (0, 10))
    assert function.color([4.9, 5.1]).tolist() == [[1, 0, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.json", preset(UseLogScale=1), "UseLogScale: got 1, expected a linear scale"),
        ("a.json", preset(UseAboveRangeColor=1), "UseAboveRangeColor"),
        ("a.json", preset(ColorSpace="Lab/CIEDE2000"), "expected RGB, HSV, Lab, Diverging or Step"),
        ("a.json", preset(RGBPoints=[0, 0, 0]), "a list of 3"),
        ("a.json", preset(RGBPoints=[0, 0, 0, 2]), "got the component 2"),
        ("a.json", preset(RGBPoints=[0, 0, 0, "x"]), r"RGBPoints\.3: got 'x'"),
        ("a.json", preset(Points=[0, 0, 0.5, 1.5]), "midpoint or sharpness 1.5"),
        ("a.json", preset(RGBPoints=[10**400, 0, 0, 0]), r"RGBPoints\.0"),
        ("a.json", "[{\"RGBPoints\": [NaN, 0, 0, 0]}]", "the number NaN"),
        ("a.json", "{\n\"a\": }", "line 2: Expecting value"),
        ("a.json", "[" * 100000, "no JSON"),
        ("a.json", "{}", "neither RGBPoints nor IndexedColors"),
        ("a.vp.json", {"volumeProperties": []}, "a volume property of 3D Slicer"),
        ("a.vp", "1\n2\n", "2 lines, expected a volume property of 3D Slicer"),
        ("a.vp", "1\n0\n1\n0\n0\n1\n4 0 0 1\n\n4 0 0 0 0\n", "3 numbers after the count 4"),
        ("a.ct", "<!DOCTYPE x [<!ENTITY a 'b'>]><Object/>", "declares a document type"),
        ("a.ct", "<Object name='x'/>", "expected a colour table of VisIt"),
        ("a.ct", "<Object", "no XML"),
        ("a.txt", "# nothing\n", "no label"),
        ("a.txt", "1 a 0 0\n", "line 1: got '1 a 0 0', expected LABEL NAME R G B A"),
        ("a.txt", "1 a 0 0 256 0\n", "from 0 to 255"),
        ("a.txt", "1 a 0 0 0 0\n2 a 0 0 0 0\n1 b 0 0 0 0\n", "label 1 twice"),
        ("a.txt", "1.5 a 0 0 0 0\n", "a whole number"),
        ("a.xyz", "", "unknown ending '.xyz', expected .json"),
    ],
)  # fmt: skip
def test_what_is_not_understood_is_refused_with_its_place(tmp_path, name, content, message):
    path = write(tmp_path / name, content)
    with pytest.raises(SceneError, match=message) as caught:
        TransferFunction.from_file(path)
    assert str(caught.value).startswith(path) and "\n" not in str(caught.value)


@pytest.mark.parametrize("ending", ENDINGS)
def test_damaged_files_raise_only_typed_errors(tmp_path, ending):
    rng = np.random.default_rng(7)
    if ending in (".json", ".vp", ".vp.json"):
        STEPPED.save(tmp_path / f"a{ending}")
        whole = (tmp_path / f"a{ending}").read_bytes()
    else:
        whole = b"<Object name='ColorTable'><Object/></Object>" if ending == ".ct" else SNAP.encode()
    for _ in range(60):
        damaged = bytearray(whole[: int(rng.integers(0, len(whole)))] if rng.random() < 0.3 else whole)
        for _ in range(3):
            if damaged:
                damaged[int(rng.integers(0, len(damaged)))] = int(rng.integers(0, 256))
        (tmp_path / f"b{ending}").write_bytes(damaged)
        try:
            TransferFunction.from_file(tmp_path / f"b{ending}")
        except SceneError:
            pass


def test_files_that_cannot_be_read_or_written_are_refused(tmp_path):
    (tmp_path / "folder.json").mkdir()
    for name in ("folder.json", "none.json"):
        with pytest.raises(SceneError, match=name):
            TransferFunction.from_file(tmp_path / name)
    (tmp_path / "a.vp").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SceneError, match="byte 0xff at 0"):
        TransferFunction.from_file(tmp_path / "a.vp")
    with pytest.raises(UsageError, match="a name that ends in .json"):
        STEPPED.save(tmp_path / "a.ct")


def test_a_field_takes_its_labels_from_a_table(tmp_path):
    write(tmp_path / "t.txt", SNAP)
    np.save(tmp_path / "labels.npy", np.arange(8, dtype=np.uint8).reshape(2, 2, 2))
    head = '[volume]\nfield = "radial"\nsize = [3, 3, 3]\n[[field]]\nfile = "labels.npy"\nrole = "label"\n'
    (tmp_path / "s.toml").write_text(head + 'labels_file = "t.txt"\n', encoding="utf-8")
    scene = load_scene(tmp_path / "s.toml")
    field = scene.resolve().fields[0]
    assert field.labels.tolist() == [0, 1, 2, 7] and field.factors.tolist() == [0, 1, 0.5, 0]
    assert field.colors.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert tmp_path / "t.txt" in scene.input_paths
    for text, message in (
        ('labels_file = "t.json"', r"t\.json: unknown ending '\.json', expected a label table"),
        ('labels_file = "none.txt"', r"none\.txt: no such file"),
        ('labels_file = "t.txt"\nlabels = [{ label = 1, color = "red" }]', "labels_file in place of labels"),
        ("", "or labels_file"),
    ):
        (tmp_path / "s.toml").write_text(head + text + "\n", encoding="utf-8")
        with pytest.raises(SceneError, match=message):
            load_scene(tmp_path / "s.toml").resolve()


def test_pictures_know_which_table_their_labels_had(tmp_path):
    np.save(tmp_path / "labels.npy", np.arange(8, dtype=np.uint8).reshape(2, 2, 2))
    head = '[volume]\nfield = "radial"\nsize = [3, 3, 3]\n[transfer_function]\npreset = "hot"\n'
    field = '[[field]]\nfile = "labels.npy"\nrole = "label"\nlabels_file = "t.ctbl"\n'
    (tmp_path / "s.toml").write_text(head + field, encoding="utf-8")
    told = []
    for color in ("255 0 0", "0 255 0"):
        write(tmp_path / "t.ctbl", f"1 a {color} 255\n")
        resolved = load_scene(tmp_path / "s.toml").resolve()
        told.append(MadeFrom(resolved)())
    assert told[0]["scene"] == told[1]["scene"] and told[0]["label_tables"] != told[1]["label_tables"]
