"""[[light]]: one light. A scene without any light is not shaded."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from clvol.scene.table import COLOR, LinearColor, Number, Table, Vector, wrong

_NEEDS = {"directional": "direction", "point": "position", "headlight": None}


class Light(Table):
    """A directional light, a point light or a headlight.

    A directional light travels along ``direction``, a point light shines from the world position ``position``, a
    headlight from the eye. ``color`` is linear light. ``casts_shadow`` matters only where the scene has a [shadow].
    """

    type: Literal["directional", "point", "headlight"] = Field(
        title="Kind of light.",
        description="'directional', 'point' or 'headlight'",
        examples=["headlight"],
    )
    direction: Vector | None = Field(
        None,
        title="World direction in which a directional light travels.",
        description="three finite numbers [x, y, z], the way the light travels",
        examples=[[-1.0, -1.0, -1.0]],
    )
    position: Vector | None = Field(
        None,
        title="World position of a point light.",
        description="three finite numbers [x, y, z]",
        examples=[[0.0, 200.0, 300.0]],
    )
    color: LinearColor = Field(
        (1.0, 1.0, 1.0),
        title="Colour of the light, in linear light.",
        description=COLOR,
    )
    intensity: Number = Field(1.0, ge=0, le=1e6, title="Factor on the colour.", description="a number from 0 to 1e6")
    casts_shadow: bool = Field(
        True,
        title="Whether the light casts shadows where the scene has a [shadow] table; headlights cast none.",
        description="true or false",
    )

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
