"""The keys of [multiresolution] that cut the picture into tiles."""

from __future__ import annotations

import pytest

from clvol.errors import SceneError
from clvol.scene import Multiresolution


def table(**keys) -> Multiresolution:
    return Multiresolution(**keys)


def test_by_default_every_pixel_has_a_ray():
    default = table()
    assert default.tiles == 0 and default.tile_priority == "max"
    assert (default.tile_low, default.tile_high) == (0.1, 0.9)


@pytest.mark.parametrize("keys", [
    {"tiles": 2}, {"tiles": 17}, {"tiles": 256}, {"tile_low": 1.0, "tile_high": 1.0},
    {"tile_priority": "rms"}, {"tile_low": 1e-3}, {"tile_low": 0.5, "tile_high": 0.5},
])  # fmt: skip
def test_what_makes_sense_is_taken(keys):
    made = table(**keys)
    assert all(getattr(made, name) == value for name, value in keys.items())


@pytest.mark.parametrize(("keys", "key", "expected"), [
    ({"tiles": 1}, "tiles", "2 to 256"),
    ({"tiles": -1}, "tiles", "2 to 256"),
    ({"tiles": 257}, "tiles", "2 to 256"),
    ({"tiles": 16.0}, "tiles", "2 to 256"),
    ({"tiles": True}, "tiles", "2 to 256"),
    ({"tile_priority": "most"}, "tile_priority", "'average'"),
    ({"tile_low": 0.0}, "tile_low", "greater than 0"),
    ({"tile_high": 1.1}, "tile_high", "at most 1"),
    ({"tile_low": float("nan")}, "tile_low", "greater than 0"),
    ({"tile_low": 0.95}, "tile_low", "at most multiresolution.tile_high, 0.9"),
    ({"tile_high": 0.05}, "tile_low", "at most multiresolution.tile_high, 0.05"),
])  # fmt: skip
def test_a_mistake_is_named_with_its_key(keys, key, expected):
    with pytest.raises(SceneError) as caught:
        table(**keys)
    assert caught.value.where.endswith(f"multiresolution.{key}")
    assert expected in caught.value.expected
