"""What is compiled for rays through a volume."""

from __future__ import annotations

from clvol.device.effects import effect_switches
from clvol.device.memory import value_map, voxel_switches
from clvol.device.opacity_factors import layer_functions
from clvol.device.transfer_lookup import segment_classification, transfer_pieces
from clvol.features import CLASSIFICATIONS, FILTERS, QUADRATURES
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction


def raycast_switches(
    resolved: ResolvedScene,
    *,
    lanes: int,
    skip: bool = True,
    depth: bool = True,
    function: TransferFunction | None = None,
) -> dict[str, int]:
    """What gets compiled for this scene, or with ``function`` instead of its own; nothing that changes
    from frame to frame."""
    integration = resolved.integration
    functions = layer_functions(resolved, function)
    return {
        **voxel_switches(resolved.volume, value_map(resolved.volume)),
        "LANES": lanes,
        "FILTER": FILTERS[integration.filter],
        "CLASSIFICATION": CLASSIFICATIONS[segment_classification(integration, functions)],
        "TRANSFER_PIECES": transfer_pieces(resolved, functions),
        "QUADRATURE": QUADRATURES[integration.quadrature],
        "SKIP_EMPTY": int(skip),
        "WITH_DEPTH": int(depth),
        **effect_switches(resolved),
    }
