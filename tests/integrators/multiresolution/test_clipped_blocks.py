"""Which blocks clips remove, and that the memory goes to what they leave."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.block_scenes import SHOWN, block_scene, noise
from helpers.small_scenes import waves
from reference.clip import kept_stretches

from clvol import Renderer, Scene, Volume
from clvol.integrators.multiresolution.clipped_blocks import kept_shares, removed_blocks
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.multiresolution.residency import Residency
from clvol.scene.clip import Clip
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED
from clvol.volume import Grid

SHAPE = (70, 52, 90)
CAMERA = {"position": [-90.0, -70.0, -120.0], "target": [45.0, 26.0, 35.0], "fov_degrees": 32.0}
PLANE = Clip(point=(30.0, 20.0, 30.0), normal=(1.0, 0.0, 0.3))
CLIPS = (
    (PLANE,),
    (Clip(type="box", lower=(20.0, 10.0, 5.0), upper=(60.0, 47.0, 41.0)),),
    (Clip(type="box", lower=(-20.0, -10.0, -5.0), upper=(60.0, 90.0, 41.0), keep="outside"),),
    (Clip(type="sphere", center=(45.0, 26.0, 35.0), radius=22.0),),
    (Clip(type="sphere", center=(45.0, 26.0, 35.0), radius=30.0, keep="outside"), PLANE),
)
TURN = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
SPACING = (0.7, 1.3, 1.0)
MIDDLE = TURN @ (np.array(SPACING) * (np.array(SHAPE[::-1]) - 1.0) / 2.0)
GRIDS = (
    Grid(SHAPE),
    Grid(SHAPE, spacing=SPACING, origin=tuple(np.array([45.0, 26.0, 35.0]) - MIDDLE), direction=TURN),
)


def points_of(blocks: BlockGrid, grid: Grid, reach: float) -> np.ndarray:
    """[n, k, 3]: world places in blocks and up to ``reach`` voxels around them."""
    share = np.linspace(-0.5, 0.5, 12)
    offsets = np.stack(np.meshgrid(share, share, share, indexing="ij"), -1).reshape(-1, 3) * (blocks.edge + 2 * reach)
    middle = (blocks.places(np.arange(blocks.count))[:, ::-1] + 0.5) * blocks.edge - 0.5
    index = np.clip(middle[:, None] + offsets, -0.5, np.array(blocks.shape[::-1]) - 0.5)
    to_world = grid.index_to_world()
    return index @ to_world[:3, :3].T + to_world[:3, 3]


def keeps(clip: Clip, at: np.ndarray) -> np.ndarray:
    if clip.type == "plane":
        inside = (at - np.array(clip.point)) @ np.array(clip.normal) >= 0
    elif clip.type == "box":
        inside = ((at >= np.array(clip.lower)) & (at <= np.array(clip.upper))).all(axis=-1)
    else:
        inside = np.linalg.norm(at - np.array(clip.center), axis=-1) <= clip.radius
    return inside if clip.keep == "inside" else ~inside


@pytest.mark.parametrize("grid", GRIDS, ids=("straight", "turned"))
@pytest.mark.parametrize("clips", CLIPS)
def test_removed_blocks_have_nothing_kept_within_a_gradients_reach(grid, clips):
    blocks = BlockGrid(SHAPE)
    removed = removed_blocks(clips, grid, blocks)
    by_one = [~keeps(clip, points_of(blocks, grid, 1.5)).any(axis=1) for clip in clips]
    kept = np.all([keeps(clip, points_of(blocks, grid, 1.5)) for clip in clips], axis=0)
    assert not kept[removed].any() and 0 < removed.sum() < blocks.count
    if grid is GRIDS[0]:  # and of those that one clip removes, few that have nothing near are left
        apart = np.any(by_one, axis=0)
        assert (apart & ~removed).sum() <= 0.35 * apart.sum()
    shares = kept_shares(clips, grid, blocks, np.ones(blocks.count, bool))
    inside = np.all([keeps(clip, points_of(blocks, grid, 0.0)) for clip in clips], axis=0).mean(axis=1)
    assert np.quantile(np.abs(shares - inside), 0.9) < 0.15 and (shares[removed] == 0).all()


def clip_scene(clips, memory="160 KiB", **more):
    return Scene(
        volume=more.pop("volume"), transfer_function=SHOWN, camera=CAMERA, clip=clips,
        image={"width": 40, "height": 32},
        integration={"method": "multiresolution", "classification": "post", "step": 0.9, "early_termination": 0.0},
        multiresolution={"memory": memory, "stepping": "full"}, **more,
    )  # fmt: skip


def tables(clips):
    left_out = {"plane": {"keep"}}
    return [clip.model_dump(exclude_none=True, exclude=left_out.get(clip.type)) for clip in clips]


def test_blocks_that_clips_remove_are_dropped_and_change_nothing(context):
    volume = Volume(waves(SHAPE, np.uint8))
    resolved = clip_scene(tables(CLIPS[4]), "8 MiB", volume=volume).resolve()
    engine = MultiresolutionEngine(context, resolved)
    found = engine.render(resolved.camera, 40, 32)
    removed = removed_blocks(resolved.clips, volume.grid, BlockGrid(SHAPE))
    assert (engine.residency.blocks.levels[removed] == DROPPED).all() and removed.sum() > 10
    assert (engine.residency.blocks.levels[~removed] == 0).all()
    whole = Residency(context, resolved)
    whole.ask(block_scene(volume, camera=resolved.camera, settings={"memory": "8 MiB"}))
    assert not (whole.blocks.levels == DROPPED).any()
    every = MultiresolutionEngine(context, resolved)
    every.residency.blocks.load(np.zeros(len(removed), np.uint8), np.zeros(len(removed)))
    every.caster.set_resident()
    np.testing.assert_array_equal(every.caster.render(resolved.camera, 40, 32).rgba, found.rgba)
    assert found.rgba[..., 3].max() > 0.3


def test_moved_clips_select_blocks_anew(context):
    """The memory goes to what is left, and a renderer shows it as one does that starts there."""
    volume = noise(SHAPE)
    near, far = (clip_scene([{"point": [x, 0.0, 0.0], "normal": [s, 0.0, 0.0]}], volume=volume)
                 for x, s in ((30.0, -1.0), (62.0, 1.0)))  # fmt: skip
    pictures = []
    with Renderer(near, context.device) as renderer:
        pictures.append(renderer.render())
        renderer.set_scene(far)
        pictures.append(renderer.render())
    with Renderer(far, context.device) as renderer:
        fresh = renderer.render()
    np.testing.assert_array_equal(pictures[1].rgba, fresh.rgba)
    blocks = [frame.stats["blocks"] for frame in pictures]
    assert all(found["dropped"] == BlockGrid(SHAPE).count - sum(found["levels"]) > 20 for found in blocks)
    # A larger share of what is left is at full resolution than of all.
    with Renderer(clip_scene([], volume=volume), context.device) as renderer:
        whole = renderer.render().stats["blocks"]
    share = [found["levels"][0] / sum(found["levels"]) for found in (*blocks, whole)]
    assert min(share[:2]) > 1.5 * share[2]


def test_rays_and_blocks_agree_on_what_is_kept():
    """Every kept stretch of a ray passes only blocks that are there."""
    grid, blocks = GRIDS[1], BlockGrid(SHAPE)
    rng = np.random.default_rng(3)
    lower, upper = grid.world_corners().min(axis=0), grid.world_corners().max(axis=0)
    origin = lower + rng.random((300, 3)) * (upper - lower)
    direction = rng.normal(size=(300, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    for clips in CLIPS:
        removed = removed_blocks(clips, grid, blocks)
        kept = kept_stretches(grid, clips, origin, direction)
        enter, leave = kept.enter[:, 0], kept.leave[:, 0]
        there = np.isfinite(enter) & np.isfinite(leave)
        for share in np.linspace(0.0, 1.0, 30):
            t = (1.0 - share) * enter[there] + share * leave[there]
            at = origin[there] + t[:, None] * direction[there]
            to_index = grid.world_to_index()
            p = at @ to_index[:3, :3].T + to_index[:3, 3] + 0.5
            x, y, z = np.clip(p // blocks.edge, 0, np.array(blocks.counts[::-1]) - 1).astype(int).T
            assert not removed.reshape(blocks.counts)[z, y, x].any()
