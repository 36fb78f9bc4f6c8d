"""Factors on opacity by the gradient, and two-dimensional transfer functions."""

from __future__ import annotations

import numpy as np

from clvol.features.effect import Effect, counted, no, yes
from clvol.features.findings import Findings, has_no_gradient
from clvol.features.noise import with_octaves_that_count
from clvol.features.values import reachable, steepest
from clvol.scene.noise import Noise
from clvol.scene.opacity_factor import OpacityFactor
from clvol.scene.resolve import ResolvedScene


def analyse(found: Findings) -> None:
    for name, key in (
        ("gradient opacity", "gradient_opacity"),
        ("directional opacity", "directional_opacity"),
    ):
        factor = getattr(found.scene, key)
        effect = _factor(found, name, factor)
        found.note(effect)
        if factor is not None and not effect.called_for:
            found.change(**{key: None})
    _fur(found)
    layers, joint = "two-dimensional transfer function", "joint transfer function"
    is_joint = found.scene.transfer_layers and not has_gradient_layers(found.scene)
    effect = _layers(found, joint if is_joint else layers)
    found.note(no(layers, "the scene has no transfer layer by gradient magnitude"))
    found.note(no(joint, "the scene has no field of role 'value'"), effect)
    if found.scene.transfer_layers and not effect.called_for:
        without = tuple(field for field in found.scene.fields if field.role != "value")
        found.change(transfer_layers=(), fields=without if is_joint else found.scene.fields)


def has_gradient_layers(scene: ResolvedScene) -> bool:
    """Whether the scene's function has layers by gradient magnitude."""
    return bool(scene.transfer_layers) and not scene.transfer_layers[0].values


def _factor(found: Findings, name: str, factor: OpacityFactor | None) -> Effect:
    if factor is None:
        return no(name, f"the scene has no {name}")
    if np.all(factor.factors == 1):
        return no(name, f"the {name} is 1 everywhere")
    if _is_one_up_to(factor, steepest(found.scene)):
        return no(name, f"the {name} is 1 for every gradient of the volume")
    idle = _nothing_to_weight(found)
    if idle is not None:
        return no(name, idle)
    return yes(name, f"the {name} goes down to {factor.factors.min():g}")


def _fur(found: Findings) -> None:
    scene, name = found.scene, "fur"
    if not scene.fur:
        found.note(no(name, "the scene has no fur"))
        return
    kept = tuple(with_octaves_that_count(hairs) for hairs in scene.fur if hairs.amplitude != 0)
    growing = tuple(hairs for hairs in kept if _grows(hairs, scene))
    reason = _nothing_to_weight(found)
    if not growing:
        reason = "no value of the volume lies beyond the root" if kept else "the noise's amplitude is 0"
    if reason is not None:
        found.note(no(name, reason))
        found.change(fur=())
        return
    found.note(yes(name, f"{counted(len(growing), 'noise')} of target 'fur'"))
    found.change(fur=growing)


def _grows(hairs: Noise, scene: ResolvedScene) -> bool:
    """Whether any segment may lie beyond the root: chords are shifted by their curvature, at most by the range."""
    low, high = reachable(scene)
    if hairs.root is None or hairs.tip is None:
        return False
    return 2 * low - high < hairs.root if hairs.tip < hairs.root else 2 * high - low > hairs.root


def _is_one_up_to(factor: OpacityFactor, largest: float) -> bool:
    """Whether the factor is 1 from 0 to ``largest``, on both sides of a step."""
    within = factor.factors[factor.at <= largest]
    ends = [factor(0.0), factor(largest)]
    return bool(np.all(within == 1) and np.all(np.asarray(ends) == 1))


def _layers(found: Findings, name: str) -> Effect:
    scene = found.scene
    layers = scene.transfer_layers
    if not layers:
        return no(name, "the scene has no transfer layer")
    if all(layer.function == scene.transfer_function for layer in layers):
        return no(name, "every layer is the transfer function itself")
    if has_gradient_layers(scene) and has_no_gradient(scene):
        return no(name, "the volume has no gradient")
    idle = _nothing_to_weight(found)
    return no(name, idle) if idle else yes(name, counted(len(layers), "layer"))


def _nothing_to_weight(found: Findings) -> str | None:
    if found.projection:
        return f"{found.projection} does not weight opacities"
    return None if found.emits else "the transfer function shows nothing of the volume"
