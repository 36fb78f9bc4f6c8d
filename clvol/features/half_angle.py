"""Half-angle slices, which show the shadows of one light."""

from __future__ import annotations

from clvol.features.effect import no, yes
from clvol.features.findings import Findings

NAME = "half-angle slices"


def analyse(found: Findings) -> None:
    scene = found.scene
    if not scene.integration.draws_slices:
        found.note(no(NAME, f"the method is {scene.integration.method!r}"))
    elif not scene.slicing.is_half_angle:
        found.note(no(NAME, f"slices are {scene.slicing.geometry!r}"))
    elif scene.shadow is None:
        found.note(no(NAME, "no light casts a shadow"))
    else:
        found.note(yes(NAME, "light goes through the slices"))
