"""Noise and colour cycling."""

from __future__ import annotations

from clvol.features.effect import joined, no, yes
from clvol.features.findings import NOTHING_VISIBLE, Findings
from clvol.features.values import reachable
from clvol.scene.noise import Noise


def analyse(found: Findings) -> None:
    _noise(found)
    _cycle(found)


def _noise(found: Findings) -> None:
    noises, name = found.scene.noise, "noise"
    if not noises:
        found.note(no(name, "the scene has no noise"))
        return
    kept = tuple(with_octaves_that_count(noise) for noise in noises if noise.amplitude != 0)
    if not kept or found.blank:
        found.note(no(name, NOTHING_VISIBLE if kept else "the noise's amplitude is 0"))
        found.change(noise=())
        return
    found.change(noise=kept)
    reasons = (
        f"noise of amplitude {_amplitude(noise, found):g} moves every {noise.target}"
        for noise in kept
    )
    found.note(yes(name, joined(reasons)))


def _amplitude(noise: Noise, found: Findings) -> float:
    """The amplitude as the scene states it, in values."""
    return noise.amplitude * (found.scene.axis.slope if noise.target == "value" else 1.0)


def with_octaves_that_count(noise: Noise) -> Noise:
    if noise.octaves > 1 and noise.gain == 0:
        return noise.model_copy(update={"octaves": 1})
    return noise


def _cycle(found: Findings) -> None:
    scene, name = found.scene, "colour cycling"
    animation = scene.animation
    shift = animation.cycle * animation.time
    low, high = scene.volume.value_range
    reason = None
    if animation.cycle == 0:
        reason = "the cycle is 0"
    elif low == high:
        reason = "the volume has one value"
    elif not found.emits:
        reason = "the transfer function shows nothing of the volume"
    elif shift % 1.0 == 0 and reachable(scene) == (low, high):
        reason = f"the colour cycle has completed {abs(shift):g} periods"
        found.cycles_later = True
    if reason is None:
        found.note(yes(name, f"the colours are moved by {shift % 1.0:g} of the range"))
        return
    found.note(no(name, reason))
    found.change(animation=animation.model_copy(update={"cycle": 0.0}))
