"""What can hardly be meant is said with its reason and what to set; good scenes are quiet, and pictures the same."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from helpers.paths import DATA
from helpers.small_scenes import SMOOTH, waves

from clvol import Camera, Renderer, Scene, TransferFunction, Volume, load_scene, render_to_error
from clvol.errors import ClvolWarning
from clvol.explanation import explain
from clvol.features.scene_warnings import camera_warning, scene_warnings

NOISE = (np.random.default_rng(0).random((36, 34, 38)) ** 2).astype(np.float32)
SHOWN = TransferFunction([0, 1], [0, 0.5], [[1, 1, 1]] * 2)


def function(values, opacities, unit=1.0) -> TransferFunction:
    return TransferFunction(values, opacities, [[1, 1, 1]] * len(values), unit)


def scene_of(array=NOISE, transfer_function=SHOWN, spacing=1.0, **tables) -> Scene:
    volume = array if isinstance(array, Volume) else Volume(array, spacing=(spacing,) * 3)
    return Scene(volume=volume, transfer_function=transfer_function, image={"width": 40, "height": 32}, **tables)


def warned(scene: Scene, device, **how) -> tuple[list[str], np.ndarray]:
    """What stats say, which must be what Python's warnings say; and the picture."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with Renderer(scene, [device]) as renderer:
            frame = renderer.render(**how)
    ours = [str(w.message) for w in caught if issubclass(w.category, ClvolWarning)]
    assert ours == frame.stats.get("warnings", [])
    assert all(w.filename == __file__ for w in caught if issubclass(w.category, ClvolWarning))
    return ours, frame.rgba


AWAY = {"camera": Camera(position=(100.0, 20.0, 20.0), target=(200.0, 20.0, 20.0))}
BESIDE = {"camera": Camera(position=(100.0, 20.0, 20.0), target=(100.0, 20.0, -200.0))}
ABOVE = {"camera": Camera(projection="orthographic", position=(20.0, 300.0, 90.0), target=(20.0, 300.0, 0.0), height=40.0)}
FAR = {"camera": Camera(position=(1e7, 20.0, 20.0), target=(20.0, 20.0, 20.0))}
NOWHERE = {"clip": [{"point": [0.0, 0.0, 10.0], "normal": [0.0, 0.0, -1.0]},
                    {"point": [0.0, 0.0, 20.0], "normal": [0.0, 0.0, 1.0]}]}  # fmt: skip
MASKED = {"field": [{"file": Volume(np.zeros((36, 34, 38), np.uint8)), "role": "mask", "threshold": 0.5}]}
CASES = {
    "beside": (scene_of(transfer_function=function([1000, 2000], [0, 0.5])),
               "transfer_function: its points lie between 1000 and 2000, but the voxels lie between", "nothing is visible",
               "set transfer_function.points"),
    "below": (scene_of(NOISE + 5000, function([0, 255], [0.5, 0])), "transfer_function:", "between 5000 and"),
    "transparent": (scene_of(transfer_function=function([0, 1], [0, 0])), "all its opacities are 0"),
    "gap": (scene_of(transfer_function=function([0, 2, 3], [0, 0, 0.5])), "shows values above 2"),
    "projection": (scene_of(transfer_function=function([5, 6], [0, 0.5]), integration={"compositing": "maximum"}),
                   "transfer_function:", "nothing is visible"),
    "constant": (scene_of(np.full((30, 30, 30), 7.0), function([8, 9], [0, 0.5])), "all voxels are 7"),
    "eight bits of sixteen": (scene_of((NOISE * 60000).astype(np.uint16), function([0, 80, 255], [0, 0.1, 0.5])),
                              "transfer_function: its points lie between 0 and 255", "nearly all values"),
    "one of 255": (scene_of(transfer_function=function([0, 255], [0, 0.5], 0.01)), "they all look the same"),
    "hounsfield": (scene_of(transfer_function={"preset": "ct-bone"}), "transfer_function.preset: 'ct-bone'", "Hounsfield"),
    "offset hounsfield": (scene_of((NOISE * 4000).astype(np.uint16), {"preset": "ct-tissue"}), "set volume.offset"),
    "unit too large": (scene_of(transfer_function=function([0, 1], [0, 0.5], 1e6)), "transfer_function.opacity_unit:",
                       "a length of 1e+06", "set transfer_function.opacity_unit to about 1.03"),
    "spacing in metres": (scene_of(spacing=3e-4), "transfer_function.opacity_unit:", "at most 1.3 % of the light"),
    "spacing in nanometres": (scene_of(spacing=1e3), "transfer_function.opacity_unit:", "opaque within one voxel"),
    "box": (scene_of(transfer_function=function([0, 1], [1, 1])), "nothing but the faces of a box is visible"),
    "looks away": (scene_of(**AWAY), "camera: looks away"),
    "looks beside": (scene_of(**BESIDE), "camera: does not see the volume, which lies to the left of the picture"),
    "looks above": (scene_of(**ABOVE), "which lies below the picture"),
    "too far": (scene_of(**FAR), "camera: the picture is blank", "no ray"),
    "plane": (scene_of(clip=[{"point": [0.0, 0.0, -10.0], "normal": [0.0, 0.0, -1.0]}]), "clip.0: this plane removes"),
    "box clip": (scene_of(clip=[{"type": "box", "lower": [90.0, 0.0, 0.0], "upper": [99.0, 9.0, 9.0]}]), "clip.0: this box"),
    "sphere": (scene_of(clip=[{"type": "sphere", "center": [18.0, 17.0, 18.0], "radius": 90.0, "keep": "outside"}]),
               "clip.0: this sphere"),
    "two planes": (scene_of(**NOWHERE), "clip: the picture is blank", "together leave nothing"),
    "mask": (scene_of(**MASKED), "field: the picture is blank"),
    "surface beside": (scene_of(transfer_function=function([0, 1], [0, 0]), isosurface=[{"value": 7.0}]), "isosurface:", "(7)"),
    "holes alone": (scene_of(np.full((9, 9, 9), np.nan)), "volume: none of its voxels is a finite number"),
    "out of view": (scene_of(np.pad(np.full((1, 1, 1), 255.0), (0, 33)), function([200, 255], [0, 0.5]),
                             clip=[{"point": [18.0, 17.0, 18.0], "normal": [1.0, 1.0, 1.0]}]),
                    "the picture is blank", "hardly any voxel in view"),
}  # fmt: skip
GOOD = {
    "smooth": scene_of(waves((34, 35, 36)), SMOOTH),
    "default": scene_of(transfer_function=None),
    "default of one value": scene_of(np.full((30, 30, 30), 7.0), None),
    "default in nanometres": scene_of(transfer_function=None, spacing=1e3),
    "default in metres": scene_of(transfer_function=None, spacing=1e-9),
    "hounsfield": scene_of((NOISE * 4000 - 1024).astype(np.int16), {"preset": "ct-bone"}),
    "every preset": scene_of(transfer_function={"preset": "surface"}),
    "narrow peak": scene_of(waves((34, 35, 36)), function([59, 60, 61], [0, 0.8, 0])),
    "surface alone": scene_of(transfer_function=function([0, 1], [0, 0]), isosurface=[{"value": 0.4}]),
    "opaque body": scene_of(waves((34, 35, 36)), function([120, 120, 255], [0, 1, 1])),
    "constant function": scene_of(transfer_function=function([0], [0.02])),
    "maximum": scene_of(integration={"compositing": "maximum"}),
    "inside": scene_of(camera=Camera(position=(18.0, 17.0, 18.0), target=(30.0, 17.0, 18.0))),
    "clipped": scene_of(clip=[{"point": [18.0, 17.0, 18.0], "normal": [0.3, 1.0, 0.2]}]),
    "oblique": scene_of(Volume(NOISE, direction=np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1.0]]))),
    "small": scene_of(NOISE[:6, :7, :8], None),
    "flat": scene_of(NOISE[:1], None),
}


@pytest.mark.parametrize("case", CASES)
def test_what_can_hardly_be_meant_is_said_with_reason_and_remedy(case, device):
    scene, *parts = CASES[case]
    said, _ = warned(scene, device)
    assert len(said) == 1, said
    assert all(part in said[0] for part in parts), said
    assert "\n" not in said[0] and ": " in said[0]
    assert any(word in said[0].partition("; ")[2] for word in ("set ", "turn ", "leave ", "check ")), said


@pytest.mark.parametrize("case", GOOD)
def test_good_scenes_are_quiet(case, device):
    assert warned(GOOD[case], device)[0] == []


@pytest.mark.parametrize("depth", (True, False))
def test_a_box_is_found_with_and_without_depth(depth, device):
    assert len(warned(CASES["box"][0], device, depth=depth)[0]) == 1
    assert warned(GOOD["opaque body"], device, depth=depth)[0] == []


@pytest.mark.slow
@pytest.mark.parametrize("method", ("pyramid", "reference", "multiresolution"))
def test_every_method_warns(method, device):
    scene = scene_of(transfer_function=function([1000, 2000], [0, 0.5]), integration={"method": method})
    assert len(warned(scene, device)[0]) == 1


def test_a_cause_is_told_once_and_listed_with_every_frame(device):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with Renderer(scene_of(), [device]) as renderer:
            assert "warnings" not in renderer.render().stats
            frames = [renderer.render(AWAY["camera"].model_copy(update={"up": (0.0, 1.0, k)})) for k in range(3)]
            assert len(caught) == 1
            renderer.set_transfer_function(function([5, 6], [0, 1]))
            frames.append(renderer.render())
            renderer.set_transfer_function(SHOWN)
            assert "warnings" not in renderer.render().stats
    assert len(caught) == 2
    assert all(len(frame.stats["warnings"]) == 1 for frame in frames)


@pytest.mark.slow
def test_pictures_to_an_error_warn_too(device):
    with pytest.warns(ClvolWarning, match="nothing is visible"):
        frame = render_to_error(CASES["beside"][0], 1e-2, devices=[device])
    assert len(frame.stats["warnings"]) == 1


def test_explain_says_what_needs_no_picture():
    assert explain(GOOD["smooth"].resolve())["warnings"] == []
    for case in ("beside", "hounsfield", "unit too large", "looks away", "plane"):
        (told,) = explain(CASES[case][0].resolve())["warnings"]
        assert all(part in told for part in CASES[case][1:])


@pytest.mark.parametrize("name", ("demo", "cloud", "fireball"))
def test_shipped_scenes_are_quiet(name, device):
    size = ["image.width=48", "image.height=36", "animation.frames=1"]
    assert warned(load_scene(DATA / f"{name}.toml", size), device)[0] == []


def test_a_volume_in_the_corner_of_the_picture_is_seen():
    """Whatever the view: no warning where a ray meets the volume."""
    rng = np.random.default_rng(3)
    grid = Volume(NOISE).grid
    corners = grid.world_corners()
    for _ in range(200):
        target = corners[rng.integers(8)] * 0.98 + 0.4
        position = target + rng.normal(size=3) * 60
        camera = Camera(position=tuple(position), target=tuple(target), fov_degrees=float(rng.uniform(1, 120)))
        assert camera_warning(camera.complete(grid, scene_of().image), grid, 40, 32) is None


@pytest.mark.parametrize("spacing", (1e-28, 1.0, 1e28))
@pytest.mark.parametrize("unit", (1e-300, 1.0, 1e300))
@pytest.mark.parametrize("largest", (1e-300, 1.0, 1e300))
def test_no_numbers_are_too_large_or_small_to_be_looked_at(spacing, unit, largest):
    """Without a numerical warning or an error; each line says one thing."""
    data = np.linspace(-largest, largest, 4 * 5 * 6).reshape(4, 5, 6)
    for values in ([-largest, 0, largest], [-1e308, 0, 1e308], [0.0, 1e-320, 1.0]):
        resolved = scene_of(Volume(data, spacing=(spacing,) * 3), function(values, [0.0, 0.5, 1.0], unit)).resolve()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for said in scene_warnings(resolved):
                assert str(said).count("\n") == 0 and "nan" not in str(said)
