"""[[clip]]: a plane that keeps the side its normal points to."""

from __future__ import annotations

from pydantic import Field, model_validator

from clvol.scene.table import Table, Vector, wrong


class Clip(Table):
    """World coordinates; ``normal`` of any length but 0."""

    point: Vector = Field(description="three finite numbers [x, y, z]")
    normal: Vector = Field(description="three finite numbers [x, y, z], not all 0")

    @classmethod
    def table_name(cls) -> str:
        return "clip"

    @model_validator(mode="after")
    def _normal_is_not_zero(self) -> Clip:
        if not any(self.normal):
            raise wrong("normal", list(self.normal), "a vector that is not 0")
        return self
