"""The switches (-D) of the ray caster's kernels."""

from __future__ import annotations

from clvol.device.effect_switches import effect_switches
from clvol.device.memory import value_map, voxel_switches
from clvol.device.opacity_factors import layer_functions
from clvol.device.transfer_lookup import segment_classification, transfer_pieces
from clvol.features import CLASSIFICATIONS, FILTERS, QUADRATURES
from clvol.features.minification import has_levels
from clvol.features.segments import has_integral_table
from clvol.integrators.raycast.constant_cells import uses_constant_cells
from clvol.integrators.raycast.step_map import CELL_SHIFT, follows_data
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction
from clvol.volume.voxel_layout import holds_pairs


def raycast_switches(
    resolved: ResolvedScene,
    *,
    lanes: int,
    skip: bool = True,
    depth: bool = True,
    function: TransferFunction | None = None,
    varies: bool = False,
) -> dict[str, int]:
    """The switches for this scene, or for ``function`` in place of its transfer function. They depend on nothing
    that changes from frame to frame. ``varies``: whether the march can take several steps at once."""
    integration, volume = resolved.integration, resolved.volume
    functions = layer_functions(resolved, function)
    effects = effect_switches(resolved)
    repeats = varies and lanes > 1 and not has_levels(integration)  # where voxels do, so do samples
    return {
        **voxel_switches(volume, value_map(volume), pairs=holds_pairs(volume)),
        "LANES": lanes,
        "FILTER": FILTERS[integration.filter],
        "CLASSIFICATION": CLASSIFICATIONS[segment_classification(integration, functions)],
        "TRANSFER_PIECES": transfer_pieces(resolved, functions),
        "QUADRATURE": QUADRATURES[integration.quadrature],
        "SKIP_EMPTY": int(skip),
        "WITH_DEPTH": int(depth),
        **effects,
        **({"CONSTANT_CELLS": 1} if repeats and uses_constant_cells(resolved, effects, function) else {}),
        **({"MINIFICATION": 1} if has_levels(integration) else {}),
        **({"INTEGRAL_TABLE": integration.table_size} if has_integral_table(integration) else {}),
        **({"STEP_CELLS": CELL_SHIFT} if varies and follows_data(resolved, function) else {}),
    }
