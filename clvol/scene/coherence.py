"""[coherence]: what rays that are close to each other, in the picture, may share."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Table


class Coherence(Table):
    """How rays find the part of the volume in which anything is visible. The picture does not depend on it.

    With ``mode`` "cells" the ray caster first finds for packets of 4 by 4 pixels between which depths any of them can
    see anything, from the cells in which anything can be visible. "off": each ray looks for itself. "auto": what is
    expected to be fastest, today "cells".
    """

    mode: Literal["auto", "cells", "off"] = Field(
        "auto",
        title="Whether rays close to each other leap over empty space together; the picture is the same.",
        description="'auto', 'cells' (packets of pixels leap together) or 'off' (each ray by itself)",
    )

    @classmethod
    def table_name(cls) -> str:
        return "coherence"
