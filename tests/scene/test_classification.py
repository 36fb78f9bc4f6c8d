"""The classification "auto": midpoints where they err less, pre-integration elsewhere."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from clvol import Renderer, Scene
from clvol.explanation import explain
from clvol.scene import classification
from clvol.scene.classification import chosen_for, rule_errors, with_classification
from clvol.transfer import TransferFunction
from clvol.volume import Volume

COLORS = [[0.2, 0.3, 0.9], [0.3, 0.9, 0.2], [0.9, 0.5, 0.1]]
SMOOTH = TransferFunction([0.0, 120.0, 255.0], [0.002, 0.02, 0.06], COLORS)
PEAK = TransferFunction([118.0, 120.0, 122.0], [0.0, 0.8, 0.0], COLORS)


def volume_of(seed: int = 0, edge: int = 24) -> Volume:
    """A sum of waves: values from 0 to 255 that change by up to 40 between voxels."""
    rng = np.random.default_rng(seed)
    place = np.stack(np.meshgrid(*[np.arange(edge)] * 3, indexing="ij"), axis=-1)
    waves = sum(np.sin(place @ rng.uniform(-0.5, 0.5, 3) + rng.uniform(0, 6)) for _ in range(5))
    low, high = waves.min(), waves.max()
    return Volume(np.round((waves - low) / (high - low) * 255).astype(np.uint8))


def scene_of(function: TransferFunction, volume: Volume | None = None, **integration) -> Scene:
    return Scene(
        volume=volume or volume_of(), transfer_function=function, image={"width": 32, "height": 32},
        integration={"early_termination": 0.0, **integration},
    )  # fmt: skip


@pytest.mark.parametrize("function, expected", [(SMOOTH, "post"), (PEAK, "preintegrated")], ids=["smooth", "peak"])
def test_auto_is_the_default_and_chooses_by_the_function(function, expected):
    resolved = scene_of(function).resolve()
    assert resolved.integration.classification == expected
    chosen = resolved.chosen_classification
    assert chosen is not None and chosen.name == expected and "midpoints err by" in chosen.reason
    assert explain(resolved)["classification"] == {"name": expected, "reason": chosen.reason}


@pytest.mark.parametrize("function", [SMOOTH, PEAK], ids=["smooth", "peak"])
@pytest.mark.parametrize("seed", range(3))
def test_no_picture_with_an_error_that_counts_is_less_exact_than_a_pre_integrated_one(function, seed, device):
    volume = volume_of(seed)

    def picture(**integration):
        with Renderer(scene_of(function, volume, **integration), devices=[device]) as renderer:
            return renderer.render(depth=False)

    exact = picture(method="reference").rgba
    frame = picture()
    error, other = (
        float(np.sqrt(np.mean((each.rgba - exact) ** 2))) for each in (frame, picture(classification="preintegrated"))
    )
    assert error <= max(other, 1e-4)  # what is as small either rule may have
    assert json.loads(json.dumps(frame.stats))["classification"]["name"] in ("post", "preintegrated")


@pytest.mark.parametrize("edge, sharpness", [(24, 1.5), (32, 1.5), (24, 3.0)])
def test_errors_that_cancel_along_a_ray_do_not_count(edge, sharpness, device):
    """Rays pass a translucent blob as a whole, and midpoints then err less than in pieces of it."""
    place = np.stack(np.meshgrid(*[np.linspace(-1, 1, edge)] * 3))
    speckle = 20 * np.random.default_rng(0).random((edge, edge, edge))
    volume = Volume((200 * np.exp(-sharpness**2 * (place**2).sum(axis=0)) + speckle).astype(np.uint8))
    function = TransferFunction([0.0, 255.0], [0.0, 0.2], COLORS[:2])
    errors = rule_errors(volume, function, 1.0)
    assert errors is not None and errors.post < 0.8 * errors.preintegrated

    def picture(rule: str, step: float) -> np.ndarray:
        scene = scene_of(function, volume, classification=rule, step=step, step_error=0.0)
        with Renderer(scene, devices=[device]) as renderer:
            return renderer.render(depth=False).rgba

    exact = picture("preintegrated", 0.1)
    post, preintegrated = (np.mean((picture(rule, 1.0) - exact) ** 2) for rule in ("post", "preintegrated"))
    assert post < preintegrated


@pytest.mark.parametrize("name", ["pre", "post", "preintegrated"])
def test_a_scene_that_names_its_classification_keeps_it(name):
    resolved = scene_of(PEAK, classification=name).resolve()
    assert resolved.integration.classification == name and resolved.chosen_classification is None
    assert with_classification(resolved) is resolved
    assert explain(resolved)["classification"]["reason"] == "the scene requests it"


@pytest.mark.parametrize("integration", [
    {"method": "pyramid"}, {"quadrature": "cells"}, {"filter": "cubic"}, {"filter": "nearest"},
], ids=str)  # fmt: skip
def test_what_cannot_be_compared_is_pre_integrated(integration):
    resolved = scene_of(SMOOTH, **integration).resolve()
    assert resolved.integration.classification == "preintegrated"


def test_noise_and_volumes_that_hardly_show_are_pre_integrated():
    noisy = Scene(volume=volume_of(), transfer_function=SMOOTH, noise=[{"target": "value", "amplitude": 9.0}])
    assert noisy.resolve().integration.classification == "preintegrated"
    tiny = scene_of(TransferFunction([300.0, 301.0], [0.0, 0.5], COLORS[:2])).resolve()
    assert tiny.integration.classification == "preintegrated" and "too little" in tiny.chosen_classification.reason


def test_steps_longer_than_the_volume_are_pre_integrated():
    resolved = scene_of(SMOOTH, step=1000.0).resolve()
    assert resolved.integration.classification == "preintegrated"
    assert "too little" in resolved.chosen_classification.reason


def test_voxels_that_are_not_finite_do_not_count():
    array = volume_of().data.astype(np.float32)
    array[::5, ::3, ::4] = np.nan
    errors = rule_errors(Volume(array), SMOOTH, 1.0)
    assert errors is not None and np.isfinite([errors.post, errors.preintegrated, errors.difference]).all()


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6, 1e-9])
def test_a_peak_that_steps_miss_is_pre_integrated(width):
    ramp = Volume(np.broadcast_to(np.linspace(0, 1, 9), (9, 9, 9)).copy())
    values = [0, 0.37 - width, 0.37, 0.37 + width, 1]
    function = TransferFunction(values, [0, 0, 0.9, 0, 0], np.full((5, 3), 0.5), opacity_unit=width)
    assert scene_of(function, ramp, step=0.3).resolve().integration.classification == "preintegrated"


def test_another_function_is_judged_anew():
    resolved = scene_of(SMOOTH).resolve()
    assert with_classification(replace(resolved, transfer_function=PEAK)).integration.classification == "preintegrated"
    assert chosen_for(resolved) == chosen_for(scene_of(SMOOTH).resolve())


@pytest.mark.parametrize("step, order", [(2.0, 1.0), (1.0, 0.5), (0.5, 0.25)])
def test_errors_fall_with_the_step(step, order):
    volume = volume_of()
    coarse, fine = rule_errors(volume, SMOOTH, step), rule_errors(volume, SMOOTH, order)
    assert fine.post < 0.5 * coarse.post and fine.preintegrated < 0.5 * coarse.preintegrated


def test_functions_of_one_volume_share_its_samples(monkeypatch):
    volume, read = volume_of(), []
    trilinear = classification._trilinear
    monkeypatch.setattr(classification, "_trilinear", lambda *given: read.append(1) or trilinear(*given))
    functions = [TransferFunction(SMOOTH.values, share * SMOOTH.opacities, COLORS) for share in (1.0, 0.7, 0.4)]
    found = [rule_errors(volume, function, 0.5) for function in functions]
    assert len(read) == 1 and len({errors.post for errors in found}) == 3
    # A function that shows other cells, and another step, have samples of their own.
    rule_errors(volume, PEAK, 0.5), rule_errors(volume, SMOOTH, 1.0)
    assert len(read) == 3
    assert found == [rule_errors(volume_of(), function, 0.5) for function in functions]
    assert len(read) == 6
