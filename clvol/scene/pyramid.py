"""[pyramid]: settings of the method of that name."""

from __future__ import annotations

from pydantic import Field

from clvol.scene.table import Number, Table, Whole


class Pyramid(Table):
    """``oracle`` left out means the best one."""

    levels: Whole = Field(3, ge=1, le=16, description="a whole number from 1 to 16")
    oracle: str | None = Field(None, min_length=1, description="the name of an oracle")
    epsilon: Number = Field(1e-2, gt=0, le=1, description="a number greater than 0, at most 1")

    @classmethod
    def table_name(cls) -> str:
        return "pyramid"
