"""Boxes of a kd-tree: they fill the volume, and every ray meets them in the order that the tree gives."""

from __future__ import annotations

import numpy as np
import pytest
from reference.bricks import met_in_order, over, owners

from clvol.bricks.composite import composited
from clvol.bricks.tree import divided, most_boxes

SIZES = [(40, 37, 50), (2, 2, 2), (9, 300, 5), (1 + 1, 17, 64)]


@pytest.mark.parametrize("size", SIZES)
def test_boxes_fill_the_volume_and_hold_each_place_once(size):
    random = np.random.default_rng(1)
    for count in {1, 2, 3, 5, 8, 13, 27} & set(range(1, most_boxes(size) + 1)):
        boxes = divided(size, count).boxes
        assert len(boxes) == count
        volumes = [np.prod(box.extent) for box in boxes]
        assert min(volumes) > 0 and sum(volumes) == np.prod([n - 1 for n in size])
        places = random.uniform(-0.5, np.asarray(size) - 0.5, (500, 3)).astype(np.float32)
        places[:250] = np.round(places[:250])  # on the planes between boxes
        assert (owners(places, boxes, size).sum(axis=1) == 1).all()


def test_boxes_are_about_alike():
    volumes = [np.prod(box.extent) for box in divided((101, 101, 101), 12).boxes]
    assert max(volumes) < 1.5 * min(volumes)


def test_as_many_boxes_as_are_said_to_be_possible_are():
    for size in [(5, 5, 5), (4, 9, 2), (7, 3, 3)]:
        assert len(divided(size, most_boxes(size)).boxes) == most_boxes(size)


@pytest.mark.parametrize("parallel", [False, True])
def test_no_ray_meets_boxes_in_another_order(parallel):
    random = np.random.default_rng(2)
    size = np.array([40, 37, 50])
    for count in (2, 7, 16):
        tree = divided(tuple(size), count)
        for _ in range(60):
            forward = random.normal(size=3)
            eye = None if parallel else random.uniform(-40, 90, 3)  # also inside
            order = list(tree.front_to_back(eye, forward))
            assert sorted(order) == list(range(count))
            for _ in range(10):
                target = random.uniform(0, size - 1)
                direction = forward if parallel else target - eye
                origin = target - 200 * forward if parallel else eye
                met = met_in_order(origin, direction, tree.boxes)
                assert [number for number in order if number in met] == met


def test_partial_pictures_are_put_together_from_front_to_back():
    random = np.random.default_rng(3)
    alphas = random.uniform(0, 1, (6, 4, 5, 1))
    partial = np.concatenate([alphas * random.uniform(0, 1, (6, 4, 5, 3)), alphas], axis=-1).astype(np.float32)
    np.testing.assert_allclose(composited(partial, 4, 5), over(list(partial)), atol=2e-7)
    assert np.abs(composited(partial[::-1], 4, 5) - over(list(partial))).max() > 0.01  # the order counts


def test_no_partial_picture_is_nothing():
    assert not composited([], 3, 2).any() and composited([], 3, 2).shape == (3, 2, 4)
