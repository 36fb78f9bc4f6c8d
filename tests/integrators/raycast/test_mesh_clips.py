"""Clips by closed meshes: exact to the facet, through edges and vertices, with every other clip and effect."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.meshes import box_mesh, star_mesh, write_obj, write_ply, write_stl
from helpers.twin_scenes import constant_function, ramp, scene
from reference import render_twin

import clvol
from clvol import Renderer
from clvol.errors import SceneError
from clvol.explanation import explain
from clvol.integrators.raycast.caster import Raycaster
from clvol.render.made_from import MadeFrom

ARRAY = ramp(axis=0, size=24).astype(np.float32)
LIT = {"light": [{"type": "directional", "direction": [0.3, 0.4, 1.0]}]}
BOX = [4.0, 5.0, 3.0], [18.0, 15.0, 20.0]
SIZE = 24


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("meshes")


@pytest.fixture(scope="module")
def star(folder):
    return write_obj(folder / "star.obj", *star_mesh([11.0, 12.0, 10.5], 8.0))


@pytest.fixture(scope="module")
def cube(folder):
    return write_obj(folder / "cube.obj", *box_mesh(*BOX))


def clipped(*clips, **tables):
    image = {"width": SIZE, "height": SIZE}
    return scene(ARRAY, constant_function(), clip=list(clips), image=image, **tables)


def mesh(file, **keys):
    return {"type": "mesh", "file": file, **keys}


def picture(context, resolved, **how):
    return Raycaster(context, resolved, **how).render(resolved.camera, SIZE, SIZE)


def straight(centre, height=20.0):
    """Rays along z, through places of whole multiples of an edge."""
    return {"projection": "orthographic", "height": height, "position": [*centre, -30.0],
            "target": [*centre, 0.0], "up": [0.0, 1.0, 0.0]}  # fmt: skip


# --- exactness -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("keep", ["inside", "outside"])
@pytest.mark.parametrize("camera", [None, straight([11.0, 10.0])], ids=["slanted", "straight"])
def test_a_box_of_triangles_is_a_box(context, cube, keep, camera):
    """The straight rays run through the diagonals of its faces, and along others."""
    box = {"type": "box", "lower": BOX[0], "upper": BOX[1], "keep": keep}
    more = {} if camera is None else {"camera": camera}
    triangles, plain = (picture(context, clipped(c, **LIT, **more)) for c in (mesh(cube, keep=keep), box))
    assert np.abs(triangles.rgba - plain.rgba).max() < 2e-5 and plain.rgba.max() > 0.1
    assert triangles.samples == pytest.approx(plain.samples, rel=1e-3)


@pytest.mark.parametrize("keep", ["inside", "outside"])
def test_pictures_are_the_twins_where_rays_cross_many_times(context, star, keep):
    resolved = clipped(mesh(star, keep=keep), **LIT)
    assert np.abs(picture(context, resolved).rgba - render_twin(resolved)).max() < 2e-4


def test_meshes_go_with_other_clips_and_each_other(context, star, cube):
    clips = [mesh(star), mesh(cube), {"type": "sphere", "center": [9, 9, 9], "radius": 4.0, "keep": "outside"},
             {"point": [0, 0, 6.0], "normal": [0.1, 0, 1]}]  # fmt: skip
    resolved = clipped(*clips, **LIT)
    found = picture(context, resolved)
    assert np.abs(found.rgba - render_twin(resolved)).max() < 2e-4
    turned = clipped(*clips[::-1], **LIT)
    assert np.array_equal(picture(context, turned).rgba, found.rgba)


def test_rays_through_edges_and_vertices_leave_no_gap(context, folder):
    """Kept and removed parts are all of the volume, for rays through vertices and edges of many facets."""
    vertices, triangles = star_mesh([11.0, 11.0, 11.0], 8.0, arms=0.0, rows=8)
    file = write_obj(folder / "vertices.obj", vertices, triangles)
    whole = clipped(camera=straight([11.0, 11.0]))
    caster = Raycaster(context, clipped(mesh(file), camera=straight([11.0, 11.0])))
    assert caster.resolved.clips
    depths = []
    for keep in ("inside", "outside"):
        resolved = clipped(mesh(file, keep=keep), camera=straight([11.0, 11.0]))
        depths.append(-np.log1p(-picture(context, resolved).rgba[..., 3].astype(float)))
    through = -np.log1p(-picture(context, whole).rgba[..., 3].astype(float))
    np.testing.assert_allclose(sum(depths), through, atol=2e-4)
    # Straight down on vertices, and on the middle of edges.
    a, b = vertices[triangles[:, 0]], vertices[triangles[:, 1]]
    places = np.concatenate([vertices, 0.5 * (a + b), 0.25 * a + 0.75 * b])
    for place in places[:: max(len(places) // 12, 1)]:
        camera = straight(place[:2], height=0.25)
        sides = ("inside", "outside")
        both = [picture(context, clipped(mesh(file, keep=k), camera=camera)).rgba[..., 3] for k in sides]
        left = 1 - np.prod([1 - part.astype(float) for part in both], axis=0)
        np.testing.assert_allclose(left, -np.expm1(-23 * -np.log(0.9)), atol=2e-4)


def test_a_hollow_mesh_keeps_its_shell(context, folder):
    (outer, faces), (inner, _) = box_mesh([2, 2, 2], [20, 20, 20]), box_mesh([6, 6, 6], [16, 16, 16])
    file = write_obj(folder / "hollow.obj", np.concatenate([outer, inner]), np.concatenate([faces, faces + 8]))
    resolved = clipped(mesh(file), camera=straight([11.3, 11.2], height=2.0))
    expected = -np.expm1(8 * np.log(0.9))
    np.testing.assert_allclose(picture(context, resolved).rgba[..., 3], expected, atol=1e-4)


@pytest.mark.parametrize("grid", [{"spacing": (0.5, 1.0, 2.0), "origin": (100.0, -50.0, 7.0)}])
def test_meshes_are_in_world_coordinates(context, folder, grid):
    low, high = (np.array(grid["origin"]) + np.array(grid["spacing"]) * at for at in ([4, 5, 3], [18, 15, 20]))
    file = write_stl(folder / "world.stl", *box_mesh(low, high))
    box = {"type": "box", "lower": low.tolist(), "upper": high.tolist()}
    found = [
        picture(context, scene(ARRAY, grid=grid, clip=[c], image={"width": SIZE, "height": SIZE}))
        for c in (mesh(file), box)
    ]
    assert np.abs(found[0].rgba - found[1].rgba).max() < 2e-5 and found[1].rgba.max() > 0.1


# --- with what else there is ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("tables", [
    {**LIT, "shadow": {"method": "rays", "bound": 0.0}},
    {"ambient_occlusion": {"directions": 8, "resolution": 5, "distance": 6.0}},
    {"isosurface": [{"value": 9.5, "opacity": 0.5}]},
    {"integration": {"compositing": "maximum"}},
], ids=lambda tables: "-".join(tables))  # fmt: skip
def test_effects_see_what_a_box_leaves(context, cube, tables):
    box = {"type": "box", "lower": BOX[0], "upper": BOX[1]}
    found, plain = (picture(context, clipped(c, **tables)) for c in (mesh(cube), box))
    # A ray along a face may be in or out.
    assert np.quantile(np.abs(found.rgba - plain.rgba).max(axis=-1), 0.99) < 1e-4
    assert plain.rgba.max() > 0.05


def test_leaps_change_no_bit(context, star):
    function = clvol.TransferFunction([0, 12, 14, 23], [0, 0, 0.4, 0.4], [[1, 0.5, 0.2]] * 4)
    image = {"width": SIZE, "height": SIZE}
    resolved = scene(ramp(axis=0, size=48).astype(np.float32), function, clip=[mesh(star)], image=image)
    leaping, walking = (picture(context, resolved, skip=skip) for skip in (True, False))
    assert np.array_equal(leaping.rgba, walking.rgba) and leaping.samples < walking.samples


@pytest.mark.slow
def test_blocks_are_clipped_by_meshes(device, star):
    tables = {"volume": clvol.Volume(ARRAY), "transfer_function": constant_function(), "clip": [mesh(star)],
              "image": {"width": SIZE, "height": SIZE}}  # fmt: skip
    with Renderer(clvol.Scene(**tables, integration={"method": "multiresolution"}), devices=[device]) as renderer:
        blocks = renderer.render()
    with Renderer(clvol.Scene(**tables), devices=[device]) as renderer:
        whole = renderer.render()
    assert np.abs(blocks.rgba - whole.rgba).max() < 5e-3


@pytest.mark.parametrize("method", ["pyramid", "reference"])
def test_methods_that_cannot_say_so(cube, method):
    with pytest.raises(SceneError, match="clip"), Renderer(
        clvol.Scene(volume=clvol.Volume(ARRAY), transfer_function=constant_function(), clip=[mesh(cube)],
                    integration={"method": method})
    ):  # fmt: skip
        pass


# --- files ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("write", [write_obj, write_stl, write_ply], ids=["obj", "stl", "ply"])
def test_files_hold_the_same_mesh(folder, write):
    file = write(folder / f"same.{write.__name__[-3:]}", *box_mesh(*BOX))
    clip = clipped(mesh(file)).clips[0]
    assert len(clip.mesh.vertices) == 8 and len(clip.mesh.triangles) == 12
    assert [corner.tolist() for corner in clip.mesh.bounds] == list(BOX)
    assert clipped(mesh(file)).clips[0].mesh is clip.mesh  # read once


@pytest.mark.parametrize("write, before, comment", [
    (write_obj, b"", "# pi\xe8ce\n"), (write_ply, b"ply\nformat ascii 1.0\n", "comment pi\xe8ce\n"),
], ids=["obj", "ply"])  # fmt: skip
@pytest.mark.parametrize("encoding", ["latin-1", "utf-8"])
def test_comments_are_in_any_encoding(folder, write, before, comment, encoding):
    file = folder / f"{encoding}.{write.__name__[-3:]}"
    write(file, *box_mesh(*BOX))
    file.write_bytes(before + comment.encode(encoding) + file.read_bytes().removeprefix(before))
    assert len(clipped(mesh(str(file))).clips[0].mesh.triangles) == 12


def test_the_file_is_an_input_of_the_scene_and_its_pictures(folder, cube):
    asked = clvol.Scene(volume=clvol.Volume(ARRAY), transfer_function=constant_function(), clip=[mesh(cube)])
    assert [str(path) for path in asked.input_paths] == [cube]
    assert len(MadeFrom(asked.resolve())()["clip_meshes"]) == 1


def test_an_open_mesh_says_where(folder):
    vertices, triangles = box_mesh(*BOX)
    file = write_obj(folder / "open.obj", vertices, triangles[1:])
    with pytest.raises(SceneError) as refused:
        clipped(mesh(file))
    text = str(refused.value)
    assert "clip.0.file" in text and "3 open edges, the first from [4, 5, 3] to" in text and "\n" not in text


@pytest.mark.parametrize("name, content, words", [
    ("none.stl", None, "No such file"), ("empty.obj", b"", "clip.0.file"),
    ("broken.ply", b"ply\nnonsense", "clip.0.file"),
    ("mesh.step", b"x", "ends in '.step'"), ("short.stl", bytes(100), "clip.0.file"),
    ("noise.stl", bytes(range(256)), "no triangles"),
])  # fmt: skip
def test_what_is_no_mesh_is_refused(folder, name, content, words):
    if content is not None:
        (folder / name).write_bytes(content)
    with pytest.raises(SceneError) as refused:
        clipped(mesh(str(folder / name)))
    assert words in str(refused.value) and "\n" not in str(refused.value)


def test_without_the_library_the_extra_is_named(folder, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "trimesh", None)
    file = write_obj(folder / "unread.obj", *box_mesh(*BOX))
    with pytest.raises(SceneError, match=r"clvol\[mesh\]"):
        clipped(mesh(file))


@pytest.mark.parametrize("clip, key", [
    ({"type": "mesh"}, "clip.0.file"), ({"type": "mesh", "file": "a.stl", "radius": 2.0}, "clip.0.radius"),
    ({"type": "sphere", "center": [0, 0, 0], "radius": 1.0, "file": "a.stl"}, "clip.0.file"),
])  # fmt: skip
def test_keys_that_do_not_go_together_are_named(clip, key):
    with pytest.raises(SceneError, match=key):
        clipped(clip)


# --- only what is called for ----------------------------------------------------------------------------------


def test_a_mesh_beside_the_volume_compiles_nothing(folder, cube):
    away = write_obj(folder / "away.obj", *box_mesh([100, 0, 0], [110, 9, 9]))
    bare, idle = explain(clipped()), explain(clipped(mesh(away, keep="outside")))
    assert idle["kernel_hash"] == bare["kernel_hash"]
    told = {effect["name"]: effect["reason"] for effect in idle["effects"]}
    assert told["clipping"] == "the clip mesh does not meet the volume"
    planes = explain(clipped({"point": [9, 9, 9], "normal": [1, 0, 0]}))
    called = explain(clipped(mesh(cube)))
    assert called["kernel_hash"] not in (bare["kernel_hash"], planes["kernel_hash"])
    lost = explain(clipped(mesh(away)))
    assert any("removes the whole volume" in warning for warning in lost["warnings"])
