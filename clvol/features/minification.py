"""Minification by levels: samples of pixels that cover several voxels come from means of these."""

from __future__ import annotations

from clvol.features.effect import no, yes
from clvol.features.findings import Findings
from clvol.scene.integration import Integration
from clvol.volume.level_layout import levels_of

NAME = "minification"


def has_levels(integration: Integration) -> bool:
    """Whether samples come from levels; of a reduced scene."""
    return integration.minification == "levels"


def analyse(found: Findings) -> None:
    integration = found.scene.integration
    if not has_levels(integration):
        found.note(no(NAME, "samples are of the voxels, whatever a pixel covers"))
        return
    levels, reason = len(levels_of(found.scene.volume)), None
    if not found.emits:
        reason = "the transfer function shows nothing of the volume"
    elif levels == 1:
        reason = "no axis has more than two voxels"
    if reason is None:
        found.note(yes(NAME, f"samples are of the voxels or of {levels - 1} coarser levels, whichever a pixel covers"))
    else:
        found.note(no(NAME, reason))
        found.change(integration=integration.model_copy(update={"minification": "off"}))
