"""Rays through blocks that start where those of the picture before first contributed: bit for bit the pictures that
start at the hull, and afresh where blocks have changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.block_scenes import means_of, resident
from helpers.small_scenes import make_scene

from clvol import Camera, TransferFunction
from clvol.integrators.multiresolution.caster import BlockCaster
from clvol.integrators.raycast.history import History
from clvol.scene import Light
from clvol.scene.coherence import Coherence
from clvol.scene.isosurface import Isosurface
from clvol.schedule.animation import orbited
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED
from clvol.store.volume_blocks import VolumeBlocks

SHAPE = (40, 48, 56)
AROUND = {"position": [80, 75, 130], "target": [27.5, 23.5, 19.5], "up": [0, 1, 0], "fov_degrees": 30.0}
SOLID = TransferFunction([0, 100, 140, 255], [0, 0, 0.6, 1.0], [[0.9, 0.5, 0.2], [0.2, 0.5, 0.9]] * 2)
FEWER = TransferFunction([0, 120, 140, 255], [0, 0, 0.6, 1.0], [[0.1, 0.9, 0.2]] * 4)
WIDTH, HEIGHT = 72, 60


def ball() -> np.ndarray:
    z, y, x = np.ogrid[: SHAPE[0], : SHAPE[1], : SHAPE[2]]
    away = np.sqrt((x - 27.5) ** 2 + (y - 23.5) ** 2 + (z - 19.5) ** 2)
    return np.clip(120 + 24 * (16 - away), 0, 255).astype(np.uint8)


def levels_of(seed: int) -> np.ndarray:
    """Blocks of the ball at levels 0 to 2, whose faces show as steps; what shows nothing is dropped."""
    grid, rng = BlockGrid(SHAPE, 16), np.random.default_rng(seed)
    levels = rng.integers(0, 3, grid.count).astype(np.uint8)
    padded = np.pad(ball(), [(0, n * 16 - m) for n, m in zip(grid.counts, SHAPE)])
    z, y, x = grid.counts
    largest = padded.reshape(z, 16, y, 16, x, 16).max(axis=(1, 3, 5)).ravel()
    return np.where(largest < 100, DROPPED, levels).astype(np.uint8)


def scene(mode="reproject", stepping="full", classification="preintegrated"):
    found = make_scene(ball(), SOLID, camera=AROUND, width=WIDTH, height=HEIGHT, classification=classification,
                       method="multiresolution")  # fmt: skip
    settings = found.multiresolution.model_copy(update={"stepping": stepping})
    return replace(found, multiresolution=settings, coherence=Coherence(mode=mode, audit=64))


class Pictures:
    def __init__(self, context, resolved):
        self.context, self.resolved, self.history = context, resolved, History()
        self.blocks = resident(context, resolved.volume, levels_of(1))

    def show(self, degrees=0.0, resolved=None):
        """The next picture's stats. Asserts that every bit is that of a picture from the hull."""
        self.resolved = resolved or self.resolved
        camera = orbited(Camera(**AROUND), degrees).complete(self.resolved.volume.grid, self.resolved.image)
        caster = BlockCaster(self.context, self.resolved, self.blocks, history=self.history)
        data = caster.render(camera, WIDTH, HEIGHT)
        off = replace(self.resolved, coherence=Coherence(mode="off"))
        expected = BlockCaster(self.context, off, self.blocks).render(camera, WIDTH, HEIGHT)
        np.testing.assert_array_equal(data.rgba.view(np.uint32), expected.rgba.view(np.uint32))
        np.testing.assert_array_equal(data.depth.view(np.uint32), expected.depth.view(np.uint32))
        assert expected.rgba[..., 3].max() > 0.9
        return {**data.notes["coherence"], "samples": data.samples, "from_hull": expected.samples}


def assert_reused(stats):
    assert not stats["reinitialised"] and stats["reason"] is None and stats["late_starts"] == 0, stats
    assert stats["reused_starts"] > 500 and stats["samples"] < 0.97 * stats["from_hull"], stats


def test_an_orbit_and_what_starts_afresh(context):
    first = scene()
    pictures = Pictures(context, first)
    assert pictures.show()["reason"] == "the first picture"
    for step in range(1, 4):
        assert_reused(pictures.show(1.5 * step))
    fewer = replace(first, transfer_function=FEWER)
    assert_reused(pictures.show(5.0, fewer))
    assert pictures.show(5.5, first)["reason"] == "the transfer function shows more"
    pictures.blocks.load(levels_of(2), means_of(VolumeBlocks(first.volume, 16)))
    assert pictures.show(6.0)["reason"] == "the blocks changed"
    assert_reused(pictures.show(6.5))
    assert pictures.show(100.0)["reason"] == "motion"


def test_steps_that_begin_anew_in_each_block_take_no_starts(context):
    pictures = Pictures(context, scene(stepping="limited"))
    for degrees in (0.0, 1.0):
        stats = pictures.show(degrees)
        assert stats["mode"] == "cells" and stats["reason"] == "steps that begin anew in each block"


@pytest.mark.slow  # programs of their own
@pytest.mark.parametrize("how", ["post", "lit", "surface"])
def test_other_marches(context, how):
    resolved = scene(classification="post" if how == "post" else "preintegrated")
    if how != "post":
        resolved = replace(resolved, lights=(Light(type="headlight"),))
    if how == "surface":
        nothing = TransferFunction([0, 255], [0, 0], [[0, 0, 0]] * 2)
        resolved = replace(resolved, transfer_function=nothing, isosurfaces=(Isosurface(value=120.0),))
    pictures = Pictures(context, resolved)
    pictures.show()
    for step in (1, 2):
        assert_reused(pictures.show(1.5 * step))
    if how == "surface":
        raised = replace(resolved, isosurfaces=(Isosurface(value=130.0),))
        assert pictures.show(4.0, raised)["reason"] == "the iso-values changed"  # voxels are not looked through
