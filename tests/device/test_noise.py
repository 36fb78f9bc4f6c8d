"""Volumetric noise: a tile that repeats, its sums over octaves, and the kernel beside its twin."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import DATA
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol.device.memory import ValueMap
from clvol.device.noise import (
    CENTRE,
    MOST_TERMS,
    TERM_DTYPE,
    TILE,
    device_noise,
    device_tiles,
    displacement_bound,
    fractal_noise,
    noise_tile,
    perturbed,
    tile_words,
    value_bound,
)
from clvol.errors import SceneError
from clvol.opencl.arguments import reads, value, writes
from clvol.scene import Noise
from clvol.scene.load import tomllib
from clvol.volume import Grid

SOURCE = str(Path(__file__).with_name("noise_at.cl"))
GRID = Grid((9, 17, 33), (0.5, 1.0, 3.0), (7.0, -2.0, 0.0))
TWO = 2.0**-24  # the rounding of a number near 1 in float32


@dataclass(frozen=True)
class Term:
    target: str = "value"
    amplitude: float = 1.0
    frequency: float = 2.0
    octaves: int = 1
    gain: float = 0.5
    seed: int = 0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)


terms = st.builds(
    Term,
    target=st.sampled_from(["value", "coordinate"]),
    amplitude=st.floats(-50, 50),
    frequency=st.floats(0.01, 40),
    octaves=st.integers(1, 8),
    gain=st.floats(0, 1.5),
    seed=st.integers(0, 2),
    velocity=st.tuples(*[st.floats(-3, 3)] * 3),
)


def places(n=256, low=-3.0, high=3.0, seed=1) -> np.ndarray:
    """float32 [n, 3]: places between tiles, and some at texels and at tiles' faces."""
    rng = np.random.default_rng(seed)
    made = rng.uniform(low, high, (n, 3)).astype(np.float32)
    made[:16] = rng.integers(-2 * TILE, 2 * TILE, (16, 3)) / TILE
    made[16:24] = rng.integers(-2, 3, (8, 3))
    made[24] = -1e-9
    return made


def lanes_of(array) -> dict:
    return {name: np.ascontiguousarray(array[:, k], np.float32) for k, name in enumerate("xyz")}


def call(context, name, noises, place, lanes, outputs, time=0.0, **values):
    n = len(place)
    made, in_value, in_place = device_noise(noises, GRID, time)
    counts = {"values": in_value, "coordinates": in_place} if name == "perturb" else {}
    kernel = context.kernel(
        SOURCE, name,
        (
            reads("tiles", np.uint32), reads("terms", TERM_DTYPE), *(reads(axis, np.float32, "n") for axis in "xyz"),
            writes(outputs, np.float32, 4, "n"), *(value(key, np.int32) for key in ("n", *counts)),
        ),
        {"LANES": lanes},
    )  # fmt: skip
    out = context.empty(np.float32, (4, n))
    kernel(
        context.queue, (n // lanes,), (1,), tiles=context.upload(device_tiles(noises)),
        terms=context.upload(made), n=n, **counts, **{outputs: out},
        **{key: context.upload(array) for key, array in lanes_of(place).items()},
    )  # fmt: skip
    return context.read(out).T.astype(np.float64)


# --- the tile -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 7, -5, 10**12])
def test_a_channel_holds_every_byte_equally_often(seed):
    tile = noise_tile(seed)
    assert tile.shape == (TILE, TILE, TILE, 4) and tile.dtype == np.uint8
    for channel in range(4):
        assert (np.bincount(tile[..., channel].ravel(), minlength=256) == TILE**3 // 256).all()
    assert (tile / 127.5 - 1.0).mean() == pytest.approx(0.0, abs=1e-12)


def test_seeds_and_channels_are_different_noise():
    channels = [noise_tile(seed)[..., c].ravel() for seed in (0, 1, 2) for c in range(4)]
    together = np.abs(np.corrcoef(channels) - np.eye(len(channels)))
    assert together.max() < 0.2  # a few hundred waves are independent in each
    noise_tile.cache_clear()
    assert np.array_equal(noise_tile(0)[..., 0].ravel(), channels[0])


def test_its_power_lies_in_the_stated_band():
    cycles = np.fft.fftfreq(TILE, 1 / TILE)
    k = np.sqrt(sum(axis**2 for axis in np.meshgrid(cycles, cycles, cycles)))
    for channel in range(4):
        power = np.abs(np.fft.fftn(noise_tile(3)[..., channel] / 127.5 - 1.0)) ** 2
        assert power[(k > CENTRE / 2) & (k < 2 * CENTRE)].sum() > 0.97 * power.sum()


def test_it_is_smooth_across_its_faces_too():
    tile = noise_tile(0).astype(float) / 127.5
    for axis in range(3):
        steps = np.abs(tile - np.roll(tile, 1, axis))
        assert 0.15 < steps.mean() < 0.3
        face = steps.take(0, axis).mean()  # from the last texel to the first
        assert face == pytest.approx(steps.mean(), rel=0.15)


def test_words_hold_the_channels_from_the_lowest_byte_up():
    words = tile_words(noise_tile(0)).reshape(TILE, TILE, TILE)
    assert words.dtype == np.uint32
    for channel in range(4):
        assert np.array_equal(words >> (8 * channel) & 255, noise_tile(0)[..., channel])


# --- the sum over octaves -------------------------------------------------------------------------


def test_at_a_texel_it_is_the_texel():
    index = np.array([[3, 30, 17], [0, 0, 31]])
    found = fractal_noise(noise_tile(0), Term(), index / TILE)
    expected = noise_tile(0)[index[:, 2], index[:, 1], index[:, 0]] / 127.5 - 1.0
    np.testing.assert_allclose(found, expected, atol=1e-12)


@given(term=terms, tiles=st.tuples(*[st.integers(-3, 3)] * 3), time=st.floats(0, 100))
@settings(max_examples=25, deadline=None)
def test_it_repeats_with_the_tile(term, tiles, time):
    place = places(32).astype(np.float64)
    one, other = (
        fractal_noise(noise_tile(term.seed), term, place + shift, time)
        for shift in (0.0, np.array(tiles))
    )
    np.testing.assert_allclose(other, one, atol=1e-9 * 2**term.octaves * 32)


@pytest.mark.parametrize("octaves", [1, 4])
def test_it_is_continuous_across_texels_and_tiles(octaves):
    rng = np.random.default_rng(0)
    place = rng.uniform(-2, 2, (600, 3))
    axis = np.arange(600) % 3
    place[np.arange(600), axis] = rng.integers(-2 * TILE, 2 * TILE, 600) / TILE
    place[:300] = np.where(np.arange(3) == axis[:300, None], np.round(place[:300]), place[:300])
    tiny = np.where(np.arange(3) == axis[:, None], 1e-8, 0.0)
    term = Term(octaves=octaves, gain=1.0)
    before, after = (fractal_noise(noise_tile(0), term, place + d) for d in (-tiny, tiny))
    assert np.abs(after - before).max() < 2e-8 * 2 * TILE * 2**octaves


@given(term=terms, time=st.floats(0, 100))
@settings(max_examples=40, deadline=None)
def test_bounds_hold(term, time):
    index = np.random.default_rng(2).uniform(-0.5, 40, (200, 3))
    moved, added = perturbed([term], GRID, index, time)
    assert np.abs(added).max() <= value_bound(term)
    length = np.abs((moved - index) * np.asarray(GRID.spacing)).max()
    assert length <= displacement_bound(term) * (1 + 1e-12) + 1e-12
    assert min(value_bound(term), displacement_bound(term)) == 0.0


def test_bounds_are_reached():
    """A bound that is far away would make nothing empty."""
    texels = np.stack(np.meshgrid(*[np.arange(TILE)] * 3), axis=-1).reshape(-1, 3) / TILE
    sums = np.abs(fractal_noise(noise_tile(0), Term(), texels)).max(axis=0)
    assert sums[3] > 0.999 * value_bound(Term())
    assert sums[:3].max() > 0.999 * displacement_bound(Term("coordinate"))
    loud = Term(amplitude=-3.0, octaves=3, gain=0.5)
    assert value_bound(loud) == pytest.approx(3.0 * 1.75, rel=1e-4)


def test_the_fireball_ends_before_its_box():
    """Where the distance alone gives 0, all noises at their worst give nothing that can be seen."""
    text = (DATA / "fireball.toml").read_text(encoding="utf-8")
    scene = tomllib.loads(text)
    points = scene["transfer_function"]["points"]
    visible = max(p["value"] for p in points if p["opacity"] == 0.0)
    assert 0.9 * visible < sum(value_bound(Noise(**term)) for term in scene["noise"]) < visible


def test_gain_does_not_matter_to_one_octave():
    place = places(64)
    one, other = (fractal_noise(noise_tile(0), Term(gain=gain), place) for gain in (0.5, 0.9))
    assert np.array_equal(one, other)


def test_velocity_moves_it_as_if_places_had_moved():
    place = places(64).astype(np.float64)
    still = Term()
    moving = Term(velocity=(0.3, -0.2, 1.7))
    later = fractal_noise(noise_tile(0), moving, place, 2.5)
    shifted = fractal_noise(noise_tile(0), still, place + 2.5 * np.array([0.3, -0.2, 1.7]))
    np.testing.assert_allclose(later, shifted, atol=1e-10)
    assert np.abs(later - fractal_noise(noise_tile(0), still, place)).mean() > 0.1
    assert np.array_equal(fractal_noise(noise_tile(0), moving, place, 0.0),
                          fractal_noise(noise_tile(0), still, place))  # fmt: skip


def test_frequency_counts_tiles_along_the_longest_edge():
    index = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 8.0]])  # 24 long, and so the longest edge
    _, added = perturbed([Term(frequency=1.0)], GRID, index)
    assert added[0] == pytest.approx(added[1], abs=1e-12)
    quarter = np.array([[0.0, 16.0, 0.0]])  # 16 of 24
    expected = fractal_noise(noise_tile(0), Term(), np.array([[0.0, 2 / 3, 0.0]]))[0, 3]
    assert perturbed([Term(frequency=1.0)], GRID, quarter)[1][0] == pytest.approx(expected)


# --- the kernel -----------------------------------------------------------------------------------


@pytest.mark.parametrize("lanes", [1, 16])
@pytest.mark.parametrize(
    "term",
    [Term(), Term(octaves=8, gain=0.8, seed=2), Term(octaves=3, velocity=(0.7, -0.4, 0.1))],
    ids=["one-octave", "eight-octaves", "moving"],
)
def test_the_kernel_is_its_twin(context, lanes, term):
    place = places(512)
    found = call(context, "noise_sums", [term], place, lanes, "sums", 1.3)
    expected = fractal_noise(noise_tile(term.seed), term, place, 1.3)
    # A texel lies 2^k * 32 to the tile; a place that is off by one rounding moves the sum so much.
    steps = 2.0 * TILE * sum((2.0 * term.gain) ** k for k in range(term.octaves))
    np.testing.assert_allclose(found, expected, atol=4 * TWO * steps)
    assert np.abs(expected).max() > 0.7


@pytest.mark.parametrize("lanes", [1, 16])
def test_far_places_stay_precise(context, lanes):
    """Whole tiles are taken away without any rounding: only the place's own remains."""
    far = (places(256) * 1000 + 12345).astype(np.float32)
    found = call(context, "noise_sums", [Term(octaves=8, gain=0.5)], far, lanes, "sums")
    expected = fractal_noise(noise_tile(0), Term(octaves=8, gain=0.5), far.astype(np.float64))
    np.testing.assert_allclose(found, expected, atol=4 * TWO * 2 * TILE * 8)


@pytest.mark.parametrize("lanes", [1, 16])
def test_a_place_that_is_lost_harms_no_other(context, lanes):
    """Lanes of rays that have ended may be anywhere."""
    place = places(64)
    lost = place.copy()
    lost[::4] = np.float32([[np.inf, np.nan, -np.inf]])
    lost[1::4, 1] = 1e30
    term = Term(octaves=2)
    alone, beside = (call(context, "noise_sums", [term], p, lanes, "sums") for p in (place, lost))
    assert np.array_equal(beside[2::4], alone[2::4]) and np.array_equal(beside[3::4], alone[3::4])
    assert np.abs(beside[1::4]).max() <= 1.5 * (1 + 1e-5)  # far away is no reason to be infinite


@pytest.mark.parametrize("lanes", [1, 16])
def test_terms_add_up_in_values_and_in_places(context, lanes):
    noises = [
        Term("coordinate", 2.5, 1.5, 2, seed=1, velocity=(0.1, 0.2, 0.3)),
        Term("value", 40.0, 3.0, 3),
        Term("coordinate", -0.7, 4.0),
        Term("value", -12.0, 0.5, 1, 0.5, 2),
    ]
    index = places(256, 0.0, 30.0)
    found = call(context, "perturb", noises, index, lanes, "done", 0.8)
    moved, added = perturbed(noises, GRID, index, 0.8)
    scale = 5.0 / min(GRID.spacing)
    np.testing.assert_allclose(found[:, :3], moved, atol=scale * 300 * TWO * 8)
    np.testing.assert_allclose(found[:, 3], added, atol=52 * 300 * TWO * 8)
    assert np.abs(moved - index).max() > 1.0 and np.abs(added).max() > 20


@pytest.mark.parametrize("lanes", [1, 16])
@pytest.mark.parametrize("octaves", [1, 8])
def test_the_kernel_too_stays_within_the_bounds(context, lanes, octaves):
    texels = np.stack(np.meshgrid(*[np.arange(TILE)] * 3), axis=-1).reshape(-1, 3) / TILE
    place = np.concatenate([texels, texels + np.float32(1e-5)]).astype(np.float32)
    term = Term(octaves=octaves, gain=1.0)
    found = np.abs(call(context, "noise_sums", [term], place, lanes, "sums"))
    assert found[:, 3].max() <= value_bound(term)
    assert found[:, :3].max() <= displacement_bound(Term("coordinate", octaves=octaves, gain=1.0))


def test_more_terms_than_there_is_room_for_are_refused():
    with pytest.raises(SceneError, match="noise: got 5, expected at most 4 terms"):
        device_noise([Term()] * (MOST_TERMS + 1), GRID)


def test_terms_of_a_seed_share_a_tile():
    assert device_tiles([Term(), Term("coordinate"), Term(seed=4)]).size == 2 * TILE**3
    noises = [Term(seed=4), Term(), Term("coordinate", seed=4)]
    made, values, coordinates = device_noise(noises, GRID)
    assert (values, coordinates) == (2, 1)
    assert made["first_texel"][:3].tolist() == [0, TILE**3, 0]
    doubled, *_ = device_noise([Term()], GRID, to_kernel=ValueMap(gain=0.25))
    assert doubled["value_amplitude"][0] == 0.25 and not doubled["amplitude"][0].any()
