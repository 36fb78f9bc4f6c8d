"""Stores and the method multiresolution: as a new user would call them."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from helpers.small_scenes import rms, waves

from clvol import Volume
from clvol.integrators.multiresolution.sample_allocator import SPARE_BYTES, overhead_bytes
from clvol.readers.zarr import StoredVolume
from clvol.store.build import build_store
from clvol.store.geometry import BlockGrid
from clvol.store.zarr_store import StoredBlocks

SMALL = ("--set", "image.width=24", "--set", "image.height=20")
BLOCKS = ("--set", 'integration.method="multiresolution"')
HOLES = waves((20, 21, 22), np.float32)
HOLES[3, 4, 5] = np.nan


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A store of 5 x 6 x 7 blocks, one that is damaged at full resolution, and one with NaN."""
    folder = tmp_path_factory.mktemp("made")
    data = waves((40, 45, 50), np.uint8)
    build_store(Volume(data, name="v"), folder / "v.zarr", edge=8, shard=32)
    build_store(Volume(HOLES), folder / "holes.zarr", edge=8)
    damaged = shutil.copytree(folder / "v.zarr", folder / "damaged.zarr")
    for shard in (damaged / "0" / "c").rglob("*"):
        if shard.is_file():
            content = bytearray(shard.read_bytes())
            content[7:-1100:50] = bytes(byte ^ 8 for byte in content[7:-1100:50])
            shard.write_bytes(content)
    np.save(folder / "v.npy", data)
    return folder


@pytest.fixture
def stores(made, folder):
    """The working folder with copies of them."""
    for path in made.iterdir():
        (shutil.copytree if path.is_dir() else shutil.copy)(path, folder / path.name)
    return folder


@pytest.fixture
def voxels_untouched(monkeypatch):
    """Whatever reads a whole store, or voxels past the blocks' levels, fails."""

    def touched(*_):
        raise AssertionError("the voxels of a store were read")

    monkeypatch.setattr(StoredVolume, "_load", touched)
    monkeypatch.setattr(StoredBlocks, "volume_level", touched)
    monkeypatch.setattr(StoredBlocks, "box", touched)


def test_a_store_is_rendered_from_its_blocks(run, stores, device):
    outcome = run("render", "v.zarr", "-o", "a.npy", *SMALL, "--stats", "s.json")
    assert (outcome.status, outcome.out) == (0, "a.npy\ns.json\n")
    stats = json.loads((stores / "s.json").read_text())
    assert stats["method"] == "multiresolution" and "tiles" not in stats
    blocks = stats["blocks"]
    assert sum(blocks["levels"]) + blocks["dropped"] == 5 * 6 * 7 and blocks["edge"] == 8
    assert blocks["pending"] == 0 and blocks["bytes_on_device"] <= blocks["bytes_allowed"]
    ramp = ("--set", 'transfer_function.preset="grayscale"')  # what is chosen unasked depends on the method
    whole = ("--set", "multiresolution.occlusion=false", *ramp)  # what is hidden is there as well
    assert run("render", "v.zarr", "-o", "a.npy", *SMALL, *whole).status == 0
    by_rays = ("--set", 'integration.method="raycast"', *ramp)
    assert run("render", "v.zarr", "-o", "b.npy", *SMALL, *by_rays).status == 0
    assert run("render", "v.npy", "-o", "c.npy", *SMALL, *ramp).status == 0
    pictures = [np.load(name) for name in ("a.npy", "b.npy", "c.npy")]
    np.testing.assert_array_equal(pictures[1], pictures[2])
    assert rms(pictures[0], pictures[2]) < 1e-3 < rms(pictures[0], 0 * pictures[0])


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "v.zarr"),
        ("info", "v.zarr", "--json"),
        ("explain", "v.zarr"),
        ("explain", "v.zarr", "--set", 'light.0.type="headlight"', "--set",
         'integration.method="raycast"'),
        ("render", "v.zarr", "-o", "a.png", *SMALL),
        ("render", "v.zarr", "-o", "a.png", *SMALL, "--time-budget", "0.2"),
        ("render", "v.zarr", "-o", "a.png", *SMALL, "--set", 'volume.nan=1.5'),
        ("render", "v.zarr", "-o", "a_%d.png", *SMALL, "--set", "animation.frames=2"),
        ("render", "v.zarr", "-o", "a.png", *SMALL, "--set", 'multiresolution.memory="80 KiB"'),
        ("explain", "holes.zarr", "--set", 'integration.method="raycast"', "--set", "volume.nan=0",
         "--set", 'transfer_function.preset="grayscale"'),
    ],
)  # fmt: skip
def test_no_voxel_of_a_store_is_read_that_is_not_in_a_wanted_block(
    run, stores, voxels_untouched, device, arguments
):
    outcome = run(*arguments)
    assert outcome.status == 0, outcome


@pytest.mark.parametrize(
    "arguments",
    [
        ("render", "v.zarr", "-o", "a.png", "--set", "integration.filter='cubic'"),
        ("render", "holes.zarr", "-o", "a.png", "--set", "volume.nan=0"),
        ("explain", "v.zarr", "--set", "integration.quadrature='cells'"),
    ],
)
def test_what_is_refused_is_so_before_voxels_are_read(
    refused, stores, voxels_untouched, nothing_left, arguments
):
    assert "voxels of a store were read" not in refused(2, *arguments)


@pytest.mark.slow
def test_a_memory_that_is_named_as_the_least_is_enough(run, refused, stores, device):
    def memory(size):
        return "render", "v.zarr", "-o", "a.npy", *SMALL, "--set", f"multiresolution.memory={size}"

    for size in ('"1 KiB"', "5000"):
        line = refused(2, *memory(size))
        assert line.startswith("v.zarr: multiresolution.memory: ")
        assert "for 210 blocks, expected at least" in line and not (stores / "a.npy").exists()
    least = line.split("at least ")[1].split()[0]
    assert run(*memory(least)).status == 0
    coarse = np.load("a.npy")
    assert np.isfinite(coarse).all() and coarse[..., 3].max() > 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["multiresolution.memory='much'"], "memory: got 'much', expected a size"),
        (["multiresolution.memory=0"], "multiresolution.memory: got 0, expected a size"),
        (["multiresolution.memory=-1"], "multiresolution.memory: got -1, expected a size"),
        (["multiresolution.tiles=1"], "multiresolution.tiles: got 1"),
        (["multiresolution.stepping='fast'"], "multiresolution.stepping: got 'fast'"),
        (["integration.filter='cubic'"], "integration.filter: got 'cubic' with the method"),
        (["integration.filter='nearest'"], "integration.filter: got 'nearest' with the method"),
        (["integration.classification='pre'"], "integration.classification: got 'pre' with"),
        (["integration.quadrature='cells'"], "integration.quadrature: got 'cells' with"),
        (["integration.voxel_precision='uint8'"], "voxel_precision: got 'uint8' with the method"),
        (["refraction.points=[{value=0, index=1.0}, {value=255, index=1.3}]"],
         "that calls for continuous refraction, expected 'raycast'"),
    ],
)
def test_what_the_method_does_not_do_is_one_line_in_every_command(
    refused, stores, nothing_left, options, said
):
    sets = [part for option in options for part in ("--set", option)]
    for command in (["render", "-o", "a.png"], ["explain"], ["tradeoff", "-o", "out"]):
        for scene, method in (("v.zarr", ()), ("v.npy", BLOCKS)):
            line = refused(2, command[0], scene, *command[1:], *method, *sets)
            assert line.startswith(f"{scene}: ") and said in line


@pytest.mark.parametrize("how", [(), ("--time-budget", "1")])
def test_a_damaged_block_is_named_and_no_picture_is_written(refused, stores, nothing_left, how):
    line = refused(2, "render", "damaged.zarr", "-o", "a.png", *SMALL, *how)
    assert line.startswith("damaged.zarr: block (")
    assert ") at level 0: is damaged, expected an undamaged store" in line


def test_a_damaged_block_that_is_not_wanted_spoils_nothing(run, stores, device):
    least = overhead_bytes(BlockGrid((40, 45, 50), 8), 0) + SPARE_BYTES
    memory = ("--set", f"multiresolution.memory={least}",  # every block is one sample
              "--set", 'transfer_function.preset="grayscale"')
    assert run("render", "damaged.zarr", "-o", "a.npy", *SMALL, *memory).status == 0
    assert run("render", "v.zarr", "-o", "b.npy", *SMALL, *memory).status == 0
    np.testing.assert_array_equal(np.load("a.npy"), np.load("b.npy"))


@pytest.mark.parametrize(
    "command", [("render", "-o", "a.png"), ("explain",), ("tradeoff", "-o", "t")]
)
def test_stores_that_are_not_whole_or_of_other_versions_are_refused(refused, stores, command):
    shutil.move(stores / "v.zarr" / "zarr.json", stores / "kept.json")
    (stores / "v.zarr" / "clvol-journal").mkdir()
    name, *options = command
    said = refused(2, name, "v.zarr", *options)
    assert said.startswith("v.zarr: ")
    root = json.loads((stores / "kept.json").read_text())
    root["attributes"]["clvol"]["version"] = 99
    (stores / "v.zarr" / "zarr.json").write_text(json.dumps(root))
    assert "stored by a newer clvol (version 99)" in refused(2, name, "v.zarr", *options)
    assert {path.name for path in stores.iterdir()}.isdisjoint({"a.png", "t"})


@pytest.mark.slow
def test_nan_as_a_number_is_refused_by_blocks_and_honoured_elsewhere(
    run, refused, stores, device
):
    fill = ("--set", "volume.nan=255")
    line = refused(2, "render", "holes.zarr", "-o", "a.npy", *SMALL, *fill)
    assert line.startswith("holes.zarr: volume.nan: got a number for a store with NaN voxels")
    by_rays = ("--set", 'integration.method="raycast"')
    assert run("render", "holes.zarr", "-o", "a.npy", *SMALL, *fill, *by_rays).status == 0
    np.save("filled.npy", np.where(np.isnan(HOLES), np.float32(255), HOLES))
    assert run("render", "filled.npy", "-o", "b.npy", *SMALL).status == 0
    np.testing.assert_array_equal(np.load("a.npy"), np.load("b.npy"))
    assert run("store", "holes.zarr", "-o", "filled.zarr", *fill).status == 0
    facts = json.loads(run("info", "filled.zarr", "--json").out)
    assert facts["nan_count"] == 0 and facts["value_range"] == [0, 255]


@pytest.mark.slow
def test_a_time_budget_refines_tiles_and_tells_how_far_it_came(run, stores, device):
    outcome = run("render", "v.zarr", "-o", "a.npy", *SMALL, "--time-budget", "5", "--stats", "s")
    assert outcome.status == 0
    assert "\n100% of pixels have rays of their own, estimated RMSE 0; " in outcome.err
    stats = json.loads((stores / "s").read_text())
    assert stats["tiles"] == {"share_of_pixels": 1.0, "estimated_rmse": 0.0}
    assert run("render", "v.zarr", "-o", "b.npy", *SMALL).status == 0
    np.testing.assert_array_equal(np.load("a.npy"), np.load("b.npy"))
    outcome = run("render", "v.zarr", "-o", "a.npy", "--time-budget", "1e-9", "--stats", "s")
    tiles = json.loads((stores / "s").read_text())["tiles"]
    assert tiles["share_of_pixels"] < 0.5 and tiles["estimated_rmse"] > 0
    for budget in ("0", "-1", "inf", "nan"):
        assert run("render", "v.zarr", "-o", "c.npy", "--time-budget", budget).status == 2


def test_an_animation_selects_blocks_anew_for_every_view(run, stores, device, monkeypatch):
    from clvol.integrators.multiresolution import residency

    views = []
    real = residency.select_blocks

    def select(source, function, background, camera, *rest, **how):
        views.append(camera.position)
        return real(source, function, background, camera, *rest, **how)

    monkeypatch.setattr(residency, "select_blocks", select)
    orbit = ("--set", "animation.frames=3", "--set", "animation.orbit_degrees=180")
    memory = ("--set", 'multiresolution.memory="75 KiB"')
    assert run("render", "v.zarr", "-o", "a_%d.npy", *SMALL, *orbit, *memory).status == 0
    assert len(set(views)) == 3
    pictures = [np.load(f"a_{k}.npy") for k in range(3)]
    assert all(rms(a, b) > 1e-3 for a, b in zip(pictures, pictures[1:]))


@pytest.mark.slow
def test_an_error_is_held_for_a_store_against_all_its_voxels(run, refused, stores, device):
    cap = ("--memory-cap", "50 KiB")
    said = refused(2, "render", "v.zarr", "-o", "a.npy", *SMALL, "--max-error", "1e-2", *cap)
    assert "on the device" in said or "errors are measured against all its voxels" in said
    outcome = run("render", "v.zarr", "-o", "a.npy", *SMALL, "--max-error", "1e-2", "--stats", "s",
                  "--set", "integration.table_size=32")  # fmt: skip
    assert outcome.status == 0
    found = json.loads((stores / "s").read_text())["accuracy"]
    assert found["bound"] <= 1e-2
    exact = ("--set", 'integration.method="reference"')
    assert run("render", "v.npy", "-o", "exact.npy", *SMALL, *exact).status == 0
    assert rms(np.load("a.npy"), np.load("exact.npy")) <= 1e-2


@pytest.mark.parametrize(
    "command", [("tradeoff", "-o", "t"), ("render", "-o", "t.npy", "--max-error", "0.1")]
)
def test_what_does_not_fit_into_memory_has_no_error_to_tell(
    refused, stores, nothing_left, monkeypatch, command
):
    monkeypatch.setattr("clvol.volume.memory.available_memory", lambda: 100_000)
    line = refused(2, command[0], "v.zarr", *command[1:], *SMALL)
    assert line.startswith("v.zarr: the volume needs 87.9 KiB in memory: errors are measured")
    assert line.endswith("expected at most 73.2 KiB (75% of the available memory)")
