"""Segments by tables of integral functions in place of the closed form."""

from __future__ import annotations

from clvol.errors import SceneError
from clvol.features.effect import no, yes
from clvol.features.findings import Findings
from clvol.scene.integration import Integration
from clvol.scene.resolve import ResolvedScene

NAME = "integral tables"


def has_integral_table(integration: Integration) -> bool:
    """Whether segments are looked up; of a reduced scene."""
    return integration.segments == "integral-table"


def analyse(found: Findings) -> None:
    integration = found.scene.integration
    if not has_integral_table(integration):
        found.note(no(NAME, "segments are integrated in closed form"))
    elif not found.emits:
        found.note(no(NAME, "the transfer function shows nothing of the volume"))
        found.change(integration=integration.model_copy(update={"segments": "pieces"}))
    else:
        found.note(yes(NAME, f"segments are looked up in integral functions of {integration.table_size} entries"))


def check_segments(resolved: ResolvedScene) -> None:
    """SceneError for integral tables where no pre-integrated segments are composited along the steps of rays."""
    integration = resolved.integration
    if not has_integral_table(integration):
        return
    for key, wanted in (
        ("method", "raycast"), ("classification", "preintegrated"), ("quadrature", "steps"), ("compositing", "over"),
    ):  # fmt: skip
        got = getattr(integration, key)
        if got != wanted:
            what = f"got 'integral-table' with the {key} {got!r}"
            raise SceneError(f"{resolved.origin}: integration.segments", what, f"'pieces', or the {key} {wanted!r}")
    if integration.filter == "nearest":
        what = "got 'integral-table' with the filter 'nearest', whose segments have one value"
        raise SceneError(f"{resolved.origin}: integration.segments", what, "'pieces', or another filter")
