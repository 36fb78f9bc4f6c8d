"""Tiles of a picture that see no iso-surface are rendered without looking for any."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

from clvol.device.light_volume import METHODS

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster


def without_surfaces(caster: Raycaster) -> Raycaster | None:
    """A caster for tiles that see no surface, but may see something else. It computes the same as ``caster`` without
    testing for surfaces. None where every tile needs that test."""
    if caster.march.renders_all_pixels:
        return None  # it looks at what is known of a ray's next surface once in many slices
    switches = caster.effects.switches
    if not switches.get("ISOSURFACES") or switches["REFRACTION"]:
        return None  # bent rays go anywhere
    if not switches["TRANSLUCENT"] or switches["SHADOWS"] == METHODS["rays"]:
        return None  # rays to lights may meet surfaces that the eye's do not
    other = copy.copy(caster)
    other.effects = caster.effects.copy()
    other.effects.switches = {**switches, "ISOSURFACES": 0}
    other.switches = {**caster.switches, "ISOSURFACES": 0}
    return other
