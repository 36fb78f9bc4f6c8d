"""[[light]]: one light; a scene without any is not shaded."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from clvol.scene.table import Color, Number, Table, Vector, wrong

_NEEDS = {"directional": "direction", "point": "position", "headlight": None}


class Light(Table):
    """A directional light travels along ``direction``, a point light shines from ``position``
    (world), a headlight from the eye. ``color`` is linear light. ``casts_shadow`` is read where the
    scene has a [shadow]."""

    type: Literal["directional", "point", "headlight"] = Field(
        description="'directional', 'point' or 'headlight'"
    )
    direction: Vector | None = Field(
        None, description="three finite numbers [x, y, z], the way the light travels"
    )
    position: Vector | None = Field(None, description="three finite numbers [x, y, z]")
    color: Color = Field((1.0, 1.0, 1.0), description="three numbers [r, g, b] from 0 to 1")
    intensity: Number = Field(1.0, ge=0, le=1e6, description="a number from 0 to 1e6")
    casts_shadow: bool = Field(True, description="true or false")

    @classmethod
    def table_name(cls) -> str:
        return "light"

    @model_validator(mode="after")
    def _has_what_its_type_needs(self) -> Light:
        needed = _NEEDS[self.type]
        for key in ("direction", "position"):
            value = getattr(self, key)
            if key == needed and value is None:
                raise wrong(key, None, f"three numbers [x, y, z] for a {self.type} light")
            if key != needed and value is not None:
                raise wrong(key, list(value), f"no {key} for a light of type {self.type!r}")
        if self.direction is not None and not any(self.direction):
            raise wrong("direction", list(self.direction), "a vector that is not 0")
        return self
