"""Associated colours: light that is independent of opacity."""

from __future__ import annotations

from clvol.errors import SceneError
from clvol.features.effect import no, yes
from clvol.features.findings import Findings
from clvol.features.values import reachable, shows
from clvol.scene.resolve import ResolvedScene

NAME = "associated colours"


def analyse(found: Findings) -> None:
    glow = found.scene.glow
    if glow is None:
        found.note(no(NAME, "the colours are not associated: what absorbs nothing emits nothing"))
    elif not found.has_values or not shows(glow.shape, *reachable(found.scene)):
        found.note(no(NAME, "no value of the volume emits light"))
        found.change(glow=None)
    else:
        found.note(yes(NAME, "values emit light whatever they absorb"))


def check_glow(resolved: ResolvedScene) -> None:
    """SceneError for what associated colours cannot be combined with."""
    if resolved.glow is None:
        return
    integration = resolved.integration
    wrong = (
        ("integration.compositing", integration.compositing, integration.compositing != "over", "'over'"),
        ("integration.classification", integration.classification, integration.classification == "pre",
         "'post' or 'preintegrated'"),
        ("transfer_layer", "layers", bool(resolved.transfer_layers), "no layers"),
        ("animation.cycle", resolved.animation.cycle, bool(resolved.animation.cycle), "0"),
    )  # fmt: skip
    for key, got, applies, expected in wrong:
        if applies:
            raise SceneError(f"{resolved.origin}: {key}", f"got {got!r} with associated colours", expected)
