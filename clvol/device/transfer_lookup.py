"""A scene's transfer functions over the values that kernels compute with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clvol.device.memory import ValueMap, value_map
from clvol.device.noise import perturbation
from clvol.device.opacity_factors import shown_function
from clvol.features import overshoot
from clvol.features.values import reachable
from clvol.scene.integration import Integration
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction
from clvol.transfer.cycle import cycled
from clvol.transfer.lookup_nodes import LookupNodes, lookup_nodes
from clvol.transfer.pieces import has_opaque_point, piece_count, register_pieces

_NODES, CONSTANT_NODES = 256, 4096  # numbers of values that maps of empty space distinguish
_WIDEST = 8.0  # number of value ranges by which noise may widen the nodes, on either side


def segment_classification(
    integration: Integration, functions: Sequence[TransferFunction] = ()
) -> str:
    """How segments are classified by ``functions``. Projections classify values, not segments.

    Under the nearest filter values jump from one sample to the next, and a pre-integrated
    segment of constant value equals a post-classified one. Under the other filters, where the opacity reaches 1 in a
    slope, the extinction has a pole: a sample in the middle of a segment may meet it, although its integral is finite.
    So such functions are integrated along segments, whatever the scene's classification.
    """
    if integration.compositing != "over":
        return "post"
    if integration.filter == "nearest":
        return "pre" if integration.classification == "pre" else "post"
    if integration.classification == "post" and any(map(has_opaque_point, functions)):
        return "preintegrated"
    return "preintegrated" if integration.classification == "auto" else integration.classification


def transfer_pieces(resolved: ResolvedScene, functions: Sequence[TransferFunction]) -> int:
    """TRANSFER_PIECES: how many pieces registers tell apart where they hold all of them, else 0. Layers differ from
    lane to lane; and where colours cycle the number of pieces changes, which must compile nothing."""
    in_memory = len(functions) > 1 or resolved.animation.cycle
    return 0 if in_memory else register_pieces(max(map(piece_count, functions)))


def scene_nodes(resolved: ResolvedScene, function: TransferFunction | None = None) -> LookupNodes:
    """The lookup nodes for a scene's volume and classification; all layers' tables share them."""
    volume, integration = resolved.volume, resolved.integration
    values = value_map(volume)
    preintegrated = segment_classification(integration) == "preintegrated"
    integer = volume.dtype.kind in "iu"
    low, high = (float(v) for v in values(volume.value_range))
    if integration.classification != "pre":  # values that are classified may overshoot the voxels
        more = overshoot(integration.filter) * (high - low)
        more = float(np.ceil(more)) if integer else more
        if resolved.noise:
            more, integer = more + _noise_range(resolved, high - low), False
        low, high = low - more, high + more
    return lookup_nodes(
        device_function(shown_function(resolved, function), values),
        (low, high),
        _NODES if preintegrated else CONSTANT_NODES,
        integer=integer,
        # Cycling colours do not stay on nodes, and tables of even nodes are made ten times as fast.
        may_warp=preintegrated and not resolved.animation.cycle,
    )


def _noise_range(resolved: ResolvedScene, span: float) -> float:
    """By how much noise widens the range of values: at most _WIDEST times the range of the volume and of the transfer
    function, so that nodes are not wasted outside it."""
    gain = value_map(resolved.volume).gain
    added = perturbation(resolved.noise, resolved.volume.grid, gain).added
    return min(added, _WIDEST * max(span, np.ptp(resolved.transfer_function.values) * gain))


def cycled_function(resolved: ResolvedScene, function: TransferFunction) -> TransferFunction:
    """``function`` with its colours shifted to their state at ``animation.time``."""
    shift, value_range, reach = color_shift(resolved), resolved.data_range, reachable(resolved)
    if shift is None:
        return function
    beyond = None if reach == value_range else reach
    return cycled(function, shift, value_range, beyond, opacity=False)


def color_shift(resolved: ResolvedScene) -> float | None:
    """The shift of cycling colours, in value ranges of the volume; None where colours do not cycle."""
    animation = resolved.animation
    return animation.cycle * animation.time if animation.cycle else None


def device_function(function: TransferFunction, values: ValueMap) -> TransferFunction:
    """The transfer function over the values that kernels compute with."""
    if values.bias == 0.0 and values.gain == 1.0:
        return function
    finite = np.clip(values(function.values), -1e300, 1e300)
    return TransferFunction(finite, function.opacities, function.colors, function.opacity_unit)
