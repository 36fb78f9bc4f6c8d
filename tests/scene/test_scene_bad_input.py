"""Every mistake in a scene is one SceneError that names file, key, value and what was expected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clvol.errors import SceneError
from clvol.scene import load_scene

GOOD = """\
version = 1

[volume]
file = "cube.npy"

[camera]
position = [10.0, 10.0, 10.0]
target = [1.0, 1.0, 1.0]

[image]
width = 8
height = 4

[transfer_function]
points = [
  { value = 0.0, opacity = 0.0, color = [0.0, 0.0, 0.0] },
  { value = 1.0, opacity = 0.5, color = [1.0, 0.5, 0.0] },
]

[[light]]
type = "headlight"

[[clip]]
point = [0.0, 0.0, 0.0]
normal = [1.0, 0.0, 0.0]
"""


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    np.save(tmp_path / "cube.npy", np.arange(27, dtype=np.uint8).reshape(3, 3, 3))
    path = tmp_path / "scene.toml"
    path.write_text(GOOD, encoding="utf-8")
    return path


def refused(path: Path, *overrides: str) -> SceneError:
    """The error of loading and resolving the scene; its text is one line."""
    with pytest.raises(SceneError) as caught:
        load_scene(path, overrides).resolve()
    error = caught.value
    assert error.exit_status == 2
    assert error.what and error.expected
    assert "\n" not in str(error) and len(str(error)) < 600
    return error


def test_the_scene_without_mistakes_is_taken(scene_file):
    resolved = load_scene(scene_file).resolve()
    assert resolved.image.width == 8 and resolved.volume.shape == (3, 3, 3)


# (override, key that the error names, the value as shown, part of what was expected)
MISTAKES = [
    # unknown keys
    ("image.widht=3", "image.widht", "3", "'width'"),
    ("imgae.width=3", "imgae", "{'width': 3}", "'image'"),
    ("image.zzz=3", "image.zzz", "3", "width, height, background"),
    ("light.0.colour=[1,1,1]", "light.0.colour", "[1, 1, 1]", "'color'"),
    ("transfer_function.points.1.alpha=1", "transfer_function.points.1.alpha", "1", "opacity"),
    ("integration.table=1", "integration.table", "1", "'table_size'"),
    # version
    ("version=2", "version", "2", "1"),
    ("version=1.0", "version", "1.0", "1"),
    ("version=true", "version", "true", "1"),
    ('version="1"', "version", "'1'", "1"),
    # wrong types
    ("image=3", "image", "3", "a table"),
    ("image=[]", "image", "[]", "a table"),
    ('image.width="8"', "image.width", "'8'", "a whole number"),
    ("image.width=8.0", "image.width", "8.0", "a whole number"),
    ("image.width=true", "image.width", "true", "a whole number"),
    ("camera.fov_degrees=true", "camera.fov_degrees", "true", "angle"),
    ('camera.fov_degrees="30"', "camera.fov_degrees", "'30'", "angle"),
    ("camera.up=[0,1]", "camera.up.2", "missing", "three finite numbers"),
    ("camera.up=[0,1,0,0]", "camera.up", "[0, 1, 0, 0]", "three finite numbers"),
    ("camera.up=3", "camera.up", "3", "three finite numbers"),
    ('camera.up=[0,"1",0]', "camera.up.1", "'1'", "three finite numbers"),
    ("light=3", "light", "3", "a list of tables"),
    ("light={type=\"headlight\"}", "light", "{'type': 'headlight'}", "a list of tables"),
    ("clip=[1]", "clip.0", "1", "a list of tables"),
    ("multiresolution.interblock=1", "multiresolution.interblock", "1", "true or false"),
    ("multiresolution.view_weighting=0", "multiresolution.view_weighting", "0", "true or false"),
    ('multiresolution.occlusion="yes"', "multiresolution.occlusion", "'yes'", "true or false"),
    ("volume.file=3", "volume.file", "3", "the name of a volume file"),
    ('volume="cube"', "volume", "'cube'", "a table"),
    ("camera.position=1979-05-27", "camera.position", "datetime.date", "three finite numbers"),
    ("transfer_function.points={}", "transfer_function.points", "{}", "a list of points"),
    # not finite
    ("camera.fov_degrees=nan", "camera.fov_degrees", "nan", "angle"),
    ("camera.position=[inf,0,0]", "camera.position.0", "inf", "finite"),
    ("camera.target=[0,-inf,0]", "camera.target.1", "-inf", "finite"),
    ("camera.up=[0,nan,0]", "camera.up.1", "nan", "finite"),
    ("image.background=[0,nan,0]", "image.background.1", "nan", "from 0 to 1"),
    ("integration.step=nan", "integration.step", "nan", "greater than 0"),
    ("integration.step=inf", "integration.step", "inf", "greater than 0"),
    ("integration.early_termination=nan", "integration.early_termination", "nan", "from 0"),
    ("transfer_function.opacity_unit=inf", "transfer_function.opacity_unit", "inf", "finite"),
    ("transfer_function.points.0.value=-inf", "transfer_function.points.0.value", "-inf", "finite"),
    ("transfer_function.points.1.opacity=nan",
     "transfer_function.points.1.opacity", "nan", "0 to 1"),
    ("volume.nan=nan", "volume.nan", "nan", "'transparent' or a finite number"),
    ("volume.nan=inf", "volume.nan", "inf", "'transparent' or a finite number"),
    ("volume.spacing=[1,nan,1]", "volume.spacing.1", "nan", "greater than 0"),
    ("light.0.intensity=inf", "light.0.intensity", "inf", "from 0"),
    ("clip.0.point=[nan,0,0]", "clip.0.point.0", "nan", "finite"),
    # sizes of images
    ("image.width=0", "image.width", "0", "from 1 to 65536"),
    ("image.height=-1", "image.height", "-1", "from 1 to 65536"),
    ("image.width=65537", "image.width", "65537", "from 1 to 65536"),
    ("image={width=65536,height=65536}", "image.width", "65536", "pixels in all"),
    # degenerate cameras
    ("camera.position=[1,1,1]", "camera.position", "[1.0, 1.0, 1.0]", "apart from the target"),
    ("camera.up=[0,0,0]", "camera.up", "[0.0, 0.0, 0.0]", "not 0"),
    ("camera.up=[1,1,1]", "camera.up", "[1.0, 1.0, 1.0]", "not parallel"),
    ("camera.up=[-3,-3,-3]", "camera.up", "[-3.0, -3.0, -3.0]", "not parallel"),
    ("camera={position=[1,1,1]}", "camera.position", "[1.0, 1.0, 1.0]", "volume's centre"),
    ("camera={position=[1,5,1],up=[0,1,0]}", "camera.up", "[0.0, 1.0, 0.0]", "not parallel"),
    ("camera.fov_degrees=0", "camera.fov_degrees", "0", "less than 180"),
    ("camera.fov_degrees=-30", "camera.fov_degrees", "-30", "less than 180"),
    ("camera.fov_degrees=180", "camera.fov_degrees", "180", "less than 180"),
    ('camera.projection="fisheye"', "camera.projection", "'fisheye'", "'orthographic'"),
    ("camera.height=0", "camera.height", "0", "greater than 0"),
    ("camera.position=[1e300,0,0]", "camera.position.0", "1e+300", "finite numbers"),
    # transfer functions
    ("transfer_function.points=[]", "transfer_function.points", "[]", "from 1"),
    ("transfer_function.points.1.value=-1",
     "transfer_function.points.1.value", "-1.0", "ascending"),
    ("transfer_function.points.1.opacity=1.01",
     "transfer_function.points.1.opacity", "1.01", "0 to 1"),
    ("transfer_function.points.0.opacity=-0.1",
     "transfer_function.points.0.opacity", "-0.1", "0 to 1"),
    ("transfer_function.points.0.color=[0,0,255]",
     "transfer_function.points.0.color.2", "255", "0 to 1"),
    ("transfer_function.points.2={value=2}",
     "transfer_function.points.2.opacity", "missing", "0 to 1"),
    ('transfer_function.preset="hot"', "transfer_function.preset", "'hot'", "not both"),
    ('transfer_function={preset="hott"}', "transfer_function.preset", "'hott'", "'hot'"),
    ('transfer_function.color_space="rgb"', "transfer_function.color_space", "'rgb'", "'linear'"),
    ("transfer_function.opacity_unit=0", "transfer_function.opacity_unit", "0", "greater than 0"),
    # integration
    ("integration.step=0", "integration.step", "0", "greater than 0"),
    ("integration.step=-1", "integration.step", "-1", "greater than 0"),
    ("integration.step=1e-9", "integration.step", "1e-09", "for this volume"),
    ("integration.early_termination=1", "integration.early_termination", "1", "less than 1"),
    ("integration.early_termination=-0.1", "integration.early_termination", "-0.1", "from 0"),
    ('integration.method="magic"', "integration.method", "'magic'", "'raycast'"),
    ('integration.filter="lanczos"', "integration.filter", "'lanczos'", "'linear'"),
    ('integration.classification="mid"', "integration.classification", "'mid'", "'post'"),
    ("integration.table_size=15", "integration.table_size", "15", "from 16 to 1024"),
    ("integration.table_size=1025", "integration.table_size", "1025", "from 16 to 1024"),
    ("integration.tolerance=0", "integration.tolerance", "0", "between 0 and 1"),
    # lights, planes, surfaces, further tables
    ('light.0.type="laser"', "light.0.type", "'laser'", "'point'"),
    ('light.0.type="directional"', "light.0.direction", "missing", "three numbers"),
    ('light.0.type="point"', "light.0.position", "missing", "three numbers"),
    ("light.0.direction=[1,0,0]", "light.0.direction", "[1.0, 0.0, 0.0]", "no direction"),
    ("light=[{}]", "light.0.type", "missing", "'headlight'"),
    ("clip.0.normal=[0,0,0]", "clip.0.normal", "[0.0, 0.0, 0.0]", "not 0"),
    ("isosurface=[{}]", "isosurface.0.value", "missing", "a finite number"),
    ("material.diffuse=2", "material.diffuse", "2", "0 to 1"),
    ('multiresolution.memory="96 bananas"', "multiresolution.memory", "'96 bananas'", "96 MiB"),
    ('multiresolution.stepping="slow"', "multiresolution.stepping", "'slow'", "'limited'"),
    ("pyramid.levels=-1", "pyramid.levels", "-1", "from 0"),
    ("pyramid.levels=6", "pyramid.levels", "6", "to 5"),
    # the volume
    ('volume.file="none.npy"', "volume.file", "'none.npy'", "a volume file"),
    ('volume.file=""', "volume.file", "''", "the name of a volume file"),
    ('volume.file="a\\u0000b.npy"', "volume.file", "'a\\x00b.npy'", "the name of a volume file"),
    ("volume={}", "volume.file", "missing", "the name of a volume file"),
    ("volume.spacing=[1,0,1]", "volume.spacing.1", "0", "greater than 0"),
    ("volume.spacing=[1,-1,1]", "volume.spacing.1", "-1", "greater than 0"),
    ("volume.dims=[0,1,1]", "volume.dims.0", "0", "greater than 0"),
]


@pytest.mark.parametrize(("override", "key", "value", "expected"), MISTAKES,
                         ids=[mistake[0] for mistake in MISTAKES])
def test_a_mistake_is_named_with_its_place_and_value(scene_file, override, key, value, expected):
    error = refused(scene_file, override)
    assert error.where == f"{scene_file}: {key}"
    assert value in error.what
    assert expected in error.expected


def test_a_missing_volume_table_is_named(scene_file):
    scene_file.write_text("version = 1\n")
    error = refused(scene_file)
    assert error.where == f"{scene_file}: volume" and error.what == "missing"


# (the file's text, place within the file)
UNREADABLE = [
    (GOOD.replace("width = 8", "width = "), "line 11, column 9"),
    (GOOD.replace("[image]", "[image"), "line 10, column 7"),
    (GOOD.replace("height = 4", "width = 4"), "line 12, column 10"),
    (GOOD.replace('"cube.npy"', "cube.npy"), "line 4, column 8"),
    (GOOD + '[pyramid]\noracle = "', "line 27"),
    ("\x00", "line 1, column 1"),
    ("width = 8\n= 3", "line 2, column 1"),
]


@pytest.mark.parametrize(("text", "place"), UNREADABLE)
def test_a_mistake_in_the_toml_is_named_with_its_line(scene_file, text, place):
    scene_file.write_text(text, encoding="utf-8")
    error = refused(scene_file)
    assert error.where == f"{scene_file}: {place}"


def test_a_file_that_is_no_text_is_refused(scene_file):
    scene_file.write_bytes(b"version = 1\n\xff\xfe\x00binary")
    assert refused(scene_file).where == f"{scene_file}: line 2"


def test_an_empty_file_lacks_a_volume(scene_file):
    scene_file.write_bytes(b"")
    assert refused(scene_file).where == f"{scene_file}: volume"


def test_endless_nesting_is_refused(scene_file):
    scene_file.write_text("x = " + "[" * 100_000)
    assert refused(scene_file).where.startswith(str(scene_file))


def test_an_integer_of_thousands_of_digits_is_refused(scene_file):
    scene_file.write_text(GOOD.replace("width = 8", "width = " + "9" * 5000))
    assert refused(scene_file).where.startswith(str(scene_file))


def test_a_number_over_every_double_is_refused(scene_file):
    error = refused(scene_file, "camera.fov_degrees=1" + "0" * 400)
    assert error.where == f"{scene_file}: camera.fov_degrees"
    error = refused(scene_file, "image.width=1" + "0" * 400)
    assert error.where == f"{scene_file}: image.width"


@pytest.mark.parametrize("name", ["none.toml", "none.nrrd", "none", "none.xyz"])
def test_a_missing_file_is_refused(tmp_path, name):
    from clvol.errors import ClvolError

    with pytest.raises(ClvolError) as caught:
        load_scene(tmp_path / name).resolve()
    assert caught.value.exit_status == 2
    assert caught.value.where == str(tmp_path / name)
    assert caught.value.what == "no such file"


def test_a_folder_called_as_a_scene_is_refused(tmp_path):
    (tmp_path / "folder.toml").mkdir()
    assert refused(tmp_path / "folder.toml").where == str(tmp_path / "folder.toml")


def test_a_file_of_an_unknown_kind_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text(GOOD)
    error = refused(tmp_path / "notes.txt")
    assert "'.txt'" in error.what and ".toml" in error.expected and ".nrrd" in error.expected
