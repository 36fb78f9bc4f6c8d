"""Emission and absorption, or a projection instead."""

from __future__ import annotations

from typing import Any

from clvol.features.effect import no, yes
from clvol.features.findings import NO_VALUES, PROJECTIONS, Findings
from clvol.features.values import range_text

_TRANSPARENT = "the transfer function is transparent over the data's range {}"
_OPAQUE = "the transfer function has opacity within the data's range {}"


def analyse(found: Findings) -> None:
    scene = found.scene
    integration = scene.integration
    transparent = _TRANSPARENT.format(range_text(scene)) if found.has_values else NO_VALUES
    if found.projection is None:
        found.note(no("projection", "the compositing is 'over'"))
        if found.emits:
            found.note(yes("emission-absorption", _OPAQUE.format(range_text(scene))))
        else:
            found.note(no("emission-absorption", transparent))
        _change(found, attenuation=1.0)
        return
    found.note(no("emission-absorption", f"{found.projection} shows one value of each ray"))
    if not found.emits:
        found.note(no("projection", transparent))
        _change(found, compositing="over", attenuation=1.0)
        return
    low, high = scene.volume.value_range
    compositing = integration.compositing
    if compositing == "attenuated-maximum" and integration.attenuation == 0 and low < high:
        compositing = "maximum"  # without attenuation they are the same
    attenuation = integration.attenuation if compositing == "attenuated-maximum" else 1.0
    # One value per ray is classified, so the classification has no consequence.
    _change(found, compositing=compositing, attenuation=attenuation, classification="post")
    found.note(yes("projection", PROJECTIONS[compositing]))


def _change(found: Findings, **settings: Any) -> None:
    integration = found.scene.integration
    found.change(integration=integration.model_copy(update=settings))
