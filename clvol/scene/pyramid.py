"""[pyramid]: settings of the method of that name."""

from __future__ import annotations

from pydantic import Field

from clvol.scene.table import Number, Table, Whole

MOST_LEVELS = 5  # MOST_LEVELS of cl/pyramid.h, the size of its arrays
DEFAULT_ORACLE = "error"


class Pyramid(Table):
    """Adaptive sampling on a pyramid of grids.

    Samples may be up to 2^``levels`` steps apart, along rays and across them. ``oracle`` names the rule that decides
    how far apart they may be (clvol/integrators/pyramid/oracles), and ``epsilon`` is the error or change it allows.
    """

    levels: Whole = Field(
        3, ge=0, le=MOST_LEVELS,
        title="Samples may be up to 2^levels steps apart, along rays and across them.",
        description=f"a whole number from 0 to {MOST_LEVELS}",
    )
    oracle: str = Field(
        DEFAULT_ORACLE, min_length=1,
        title="What allows samples to be far apart: 'minimum', 'visible', 'opacity-gradient', 'bandwidth', 'error'.",
        description="the name of an oracle",
    )
    epsilon: Number = Field(
        1e-2, gt=0, le=1,
        title="Error or change that the oracle allows; its unit depends on the oracle.",
        description="a number greater than 0, at most 1",
    )

    @classmethod
    def table_name(cls) -> str:
        return "pyramid"
