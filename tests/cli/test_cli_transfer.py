"""clvol transfer: transfer functions to other tools and back."""

from __future__ import annotations

import json

import pytest

from clvol.scene import load_scene
from clvol.transfer import TransferFunction


def test_a_colour_map_becomes_a_preset_of_paraview_and_comes_back_as_a_scene(run, folder):
    assert run("transfer", "viridis", "--range", 10, 20, "--opacity", "0,0.5", "-o", "v.json").out == "v.json\n"
    preset = json.loads((folder / "v.json").read_text())[0]
    assert preset["Name"] == "v" and preset["Points"] == [10, 0, 0.5, 0, 20, 0.5, 0.5, 0]
    printed = run("transfer", "v.json")
    assert printed.status == 0 and printed.out.startswith("[transfer_function]\n")
    (folder / "s.toml").write_text('[volume]\nfield = "constant"\nsize = [2, 2, 2]\n' + printed.out)
    function = TransferFunction.from_file("v.json")
    assert load_scene("s.toml").resolve().transfer_function == function
    assert run("transfer", "s.toml", "-o", "w.vp.json").status == 0
    assert TransferFunction.from_file("w.vp.json") == function
    assert run("transfer", "w.vp.json", "-o", "x.toml").out == "x.toml\n"


def test_a_preset_of_clvol_goes_to_slicer(run, folder):
    assert run("transfer", "hot", "--range", 0, 100, "-o", "hot.vp.json").status == 0
    function = TransferFunction.from_file("hot.vp.json")
    assert function.opacity([0, 35, 100]).tolist() == pytest.approx([0, 0.05, 0.6])
    assert run("transfer", "ct-bone").out.count("value = ") == 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("virid",), "FUNCTION: got 'virid', no colour map, expected a colour map, or a file: .toml"),
        (("none.json",), "none.json: no such file, expected a colour preset of ParaView"),
        (("viridis", "-o", "a.ct"), "--output: got 'a.ct', expected a name that ends in .json"),
        (("viridis", "--opacity", "a"), "--opacity: got 'a', expected numbers from 0 to 1 with commas between"),
        (("viridis", "--range", "2", "1"), "got the range (2.0, 1.0)"),
        (("viridis", "--entry", "x"), "--entry: given for 'viridis'"),
        (("viridis", "-o", "a.ctbl"), "a.ctbl: a transfer function that is no table of labels"),
        (("viridis", "--opacity-unit", "-1"), "opacity_unit: got -1.0, expected a finite length > 0"),
        (("s.toml", "--range", "0", "1"), "--range: given for a scene file"),
    ],
)
def test_wrong_input_is_refused_and_leaves_no_file(refused, folder, arguments, message):
    before = set(folder.iterdir())
    assert message in refused(2, "transfer", *arguments)
    assert set(folder.iterdir()) == before


def test_the_input_is_not_overwritten(refused, folder):
    TransferFunction([0, 1], [0, 1], ["red", "blue"]).save("a.json")
    text = (folder / "a.json").read_text()
    assert "a.json: is also an input" in refused(2, "transfer", "a.json", "-o", "a.json")
    assert (folder / "a.json").read_text() == text
