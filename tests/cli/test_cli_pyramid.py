"""The method pyramid: as a new user would call it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.small_scenes import rms, waves

SMALL = ("--set", "image.width=24", "--set", "image.height=20")
PYRAMID = ("--set", 'integration.method="pyramid"')
BLOCKS = ("--set", 'integration.method="multiresolution"', "--set", 'multiresolution.stepping="pyramid"')


@pytest.fixture
def volume(folder):
    np.save(folder / "v.npy", waves((40, 45, 50), np.uint8))
    return "v.npy"


def test_a_volume_is_rendered_and_its_samples_are_counted(run, volume, folder, device):
    outcome = run("render", volume, "-o", "a.npy", *SMALL, *PYRAMID, "--stats", "s.json")
    assert (outcome.status, outcome.out) == (0, "a.npy\ns.json\n")
    stats = json.loads((folder / "s.json").read_text())
    assert stats["method"] == "pyramid"
    counted = stats["counters"]
    assert set(counted) == {"oracle_samples", "syntheses", "accumulations"}
    assert 0 < stats["samples"] <= counted["oracle_samples"] and counted["accumulations"] > 0
    ramp = ("--set", 'transfer_function.preset="grayscale"')  # what is chosen unasked depends on the method
    assert run("render", volume, "-o", "a.npy", *SMALL, *PYRAMID, *ramp).status == 0
    assert run("render", volume, "-o", "b.npy", *SMALL, *ramp).status == 0
    pictures = [np.load(name) for name in ("a.npy", "b.npy")]
    assert rms(*pictures) < 0.01 < rms(pictures[0], 0 * pictures[0])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (("pyramid.levels=6",), "pyramid.levels: got 6"),
        (('pyramid.oracle="dowser"',), "pyramid.oracle: got 'dowser', expected 'minimum'"),
        (("pyramid.epsilon=0.0",), "pyramid.epsilon: got 0.0"),
        (("pyramid.epsilon=nan",), "pyramid.epsilon: got nan"),
        (('integration.classification="post"',), "integration.classification: got 'post'"),
        (('integration.quadrature="cells"',), "integration.quadrature: got 'cells'"),
        (('integration.compositing="maximum"',), "integration.compositing: got 'maximum'"),
        (('integration.filter="nearest"',), "integration.filter: got 'nearest'"),
        (("image.ray_spacing=4",), "image.ray_spacing: got 4"),
    ],
)
def test_what_it_cannot_do_is_said_in_one_line(run, volume, folder, wrong, said):
    more = [part for setting in wrong for part in ("--set", setting)]
    outcome = run("render", volume, "-o", "a.npy", *SMALL, *PYRAMID, *more)
    assert outcome.status == 2 and said in outcome.err and outcome.err.count("\n") <= 2
    assert not (folder / "a.npy").exists()


def test_noise_refracting_surfaces_and_round_clips_are_refused_by_name(run, volume, folder):
    scene = '[volume]\nfile = "v.npy"\n[integration]\nmethod = "pyramid"\n'
    for table, said in (
        ('[[noise]]\ntarget = "value"\namplitude = 9.0\n', "noise"),
        ("[[isosurface]]\nvalue = 100.0\nopacity = 0.5\nrefraction = 1.3\n", "refraction"),
        ('[[clip]]\ntype = "sphere"\ncenter = [20.0, 20.0, 20.0]\nradius = 9.0\n', "clip"),
        ('[[clip]]\ntype = "box"\nlower = [9, 9, 9]\nupper = [20, 20, 20]\nkeep = "outside"\n', "clip"),
    ):
        (folder / "s.toml").write_text("version = 1\n" + scene + table)
        outcome = run("render", "s.toml", "-o", "a.npy", *SMALL)
        assert outcome.status == 2 and said in outcome.err and "'raycast'" in outcome.err


def test_blocks_by_the_pyramid(run, volume, folder, device):
    assert run("store", volume, "-o", "v.zarr", "--edge", "8").status == 0
    outcome = run("render", "v.zarr", "-o", "a.npy", *SMALL, *BLOCKS, "--stats", "s.json")
    assert outcome.status == 0, outcome.err
    stats = json.loads((folder / "s.json").read_text())
    assert stats["counters"]["block_reads"] >= stats["samples"] > 0
    assert run("render", volume, "-o", "b.npy", *SMALL).status == 0
    assert rms(np.load("a.npy"), np.load("b.npy")) < 0.02
    for more, said in (
        (("--set", "multiresolution.tiles=16"), "multiresolution.tiles: got 16"),
        (("--set", 'integration.classification="post"'), "multiresolution.stepping: got 'pyramid'"),
        (("--set", "image.ray_spacing=4"), "image.ray_spacing: got 4 with the stepping 'pyramid'"),
    ):
        outcome = run("render", "v.zarr", "-o", "c.npy", *SMALL, *BLOCKS, *more)
        assert outcome.status == 2 and said in outcome.err


def test_explain_tells_of_both(run, volume, folder, device):
    plain, adaptive, blocks = (
        run("explain", volume, *SMALL, *how) for how in ((), PYRAMID, BLOCKS)
    )
    assert {outcome.status for outcome in (plain, adaptive, blocks)} == {0}
    assert len({outcome.out for outcome in (plain, adaptive, blocks)}) == 3


@pytest.mark.slow
def test_an_error_is_met(run, volume, folder, device):
    more = ("--max-error", "3e-3", "--stats", "s.json")
    ramp = ("--set", 'transfer_function.preset="grayscale"')  # what is chosen unasked depends on the method
    outcome = run("render", volume, "-o", "a.npy", *SMALL, *PYRAMID, *ramp, *more)
    assert outcome.status == 0, outcome.err
    assert run("render", volume, "-o", "b.npy", *SMALL, *ramp, "--set", "integration.step=0.1").status == 0
    assert rms(np.load("a.npy"), np.load("b.npy")) < 3.5e-3


def test_a_video_and_a_later_time_are_rendered(run, volume, folder, device):
    more = ("--set", "animation.frames=2", "--set", "animation.orbit_degrees=90.0")
    outcome = run("render", volume, "-o", "f_%02d.npy", *SMALL, *PYRAMID, *more)
    if outcome.status:  # stills of animations are pictures
        outcome = run("render", volume, "-o", "f_%02d.png", *SMALL, *PYRAMID, *more)
    assert outcome.status == 0, outcome.err
    assert len(list(folder.glob("f_*"))) == 2
