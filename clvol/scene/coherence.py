"""[coherence]: what rays that are close to each other, in the picture, may share."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Table, Whole


class Coherence(Table):
    """How rays find the part of the volume in which anything is visible. The picture does not depend on it.

    With ``mode`` "cells" the ray caster first finds for packets of 4 by 4 pixels between which depths any of them can
    see anything, from the cells in which anything can be visible. "off": each ray looks for itself. "auto": "cells".

    With "reproject", rays also start where those of the picture before first contributed, as the camera sees that now
    (Klein et al. 2005). What is thinner than a pixel may have been missed there, so of ``audit`` pixels one, each time
    another, is rendered as without. If any of them contributes earlier, ``late_starts`` in the picture's stats counts
    them, the whole picture is rendered again as without, and so are some after it. Pictures in which a few such details
    are missing and no audited pixel shows one remain possible, so "auto" does not choose it.
    """

    mode: Literal["auto", "cells", "reproject", "off"] = Field(
        "auto",
        title="How rays find where anything is visible, beside others or after the picture before.",
        description="'auto', 'cells' (packets of pixels leap together), 'reproject' (rays start where those of the "
        "picture before first contributed) or 'off' (each ray by itself)",
    )
    splat: Whole = Field(
        3, ge=1, le=8,
        title="With mode 'reproject', the pixels per side that a place of the picture before covers.",
        description="a whole number from 1 to 8",
    )
    audit: Whole = Field(
        64, ge=1, le=65536,
        title="With mode 'reproject', one of so many pixels is rendered from the volume's hull to check it.",
        description="a whole number from 1 to 65536",
    )

    @classmethod
    def table_name(cls) -> str:
        return "coherence"
