"""[[light]]: one light. A scene without any light is not shaded."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clvol.errors import SceneError
from clvol.scene.table import COLOR, Fraction, LinearColor, Number, Table, Vector, wrong
from clvol.scene.volume import is_path, path_text

IMAGES = (".exr", ".png")
# The keys that belong to some kinds of lights alone: for which they are needed, and for which they may be given.
_NEEDED = {
    "direction": ("directional", "spot", "image"), "position": ("point", "spot", "image"), "cone_degrees": (),
    "penumbra": (), "file": ("image",), "up": (), "fov_degrees": (),
}  # fmt: skip
_ALLOWED = {
    **_NEEDED, "cone_degrees": ("spot",), "penumbra": ("spot",), "up": ("image",), "fov_degrees": ("image",),
}  # fmt: skip
_EXPECTED = {"file": "the name of a picture (.exr, .png)"}


class Light(Table):
    """A directional light, a point light, a spot light, a projected image or a headlight.

    A directional light travels along ``direction``, a point light shines from the world position ``position``, a
    headlight from the eye. A spot light shines from ``position`` around ``direction``, as far as ``cone_degrees`` from
    it. An image light projects the picture ``file`` from ``position`` along ``direction``, as a slide projector does:
    ``up`` is where its first row goes, ``fov_degrees`` its height as an angle; beyond the picture there is no light.
    ``color`` is linear light. ``casts_shadow`` matters only where the scene has a [shadow].
    """

    type: Literal["directional", "point", "headlight", "spot", "image"] = Field(
        title="Kind of light.",
        description="'directional', 'point', 'headlight', 'spot' or 'image'",
        examples=["headlight"],
    )
    direction: Vector | None = Field(
        None,
        title="World direction in which a directional light travels, or the middle of a spot or image light.",
        description="three finite numbers [x, y, z], the way the light travels",
        examples=[[-1.0, -1.0, -1.0]],
    )
    position: Vector | None = Field(
        None,
        title="World position of a point, spot or image light.",
        description="three finite numbers [x, y, z]",
        examples=[[0.0, 200.0, 300.0]],
    )
    color: LinearColor = Field(
        (1.0, 1.0, 1.0),
        title="Colour of the light, in linear light.",
        description=COLOR,
    )
    intensity: Number = Field(1.0, ge=0, le=1e6, title="Factor on the colour.", description="a number from 0 to 1e6")
    cone_degrees: Number = Field(
        30.0, ge=0, le=180,
        title="Half angle of a spot light's cone, in degrees; 180 lights all around.",
        description="an angle from 0 to 180 degrees",
    )
    penumbra: Fraction = Field(
        0.1,
        title="Share of a spot light's cone, from its edge inwards, over which the light fades in.",
        description="a number from 0 to 1",
    )
    file: Annotated[str, BeforeValidator(path_text), AfterValidator(is_path)] | None = Field(
        None,
        title="Picture that an image light projects (.exr, .png); relative to the scene file.",
        description="the name of a picture (.exr, .png), in quotes",
        examples=["slide.png"],
    )
    up: Vector = Field(
        (0.0, 1.0, 0.0),
        title="World direction in which the first row of an image light's picture is.",
        description="three finite numbers [x, y, z], not along direction",
    )
    fov_degrees: Number = Field(
        30.0, ge=0.01, le=179,
        title="Height of an image light's picture as an angle, in degrees; its width follows from the picture.",
        description="an angle from 0.01 to 179 degrees",
    )
    casts_shadow: bool = Field(
        True,
        title="Whether the light casts shadows where the scene has a [shadow] table; headlights cast none.",
        description="true or false",
    )

    @classmethod
    def table_name(cls) -> str:
        return "light"

    @property
    def is_aimed(self) -> bool:
        """Whether the light depends on the angle to its direction."""
        return self.type in ("spot", "image")

    @property
    def has_position(self) -> bool:
        """Whether the light shines from a place in the world."""
        return self.type in _NEEDED["position"]

    @model_validator(mode="after")
    def _has_what_its_type_needs(self) -> Light:
        for key, kinds in _NEEDED.items():
            value, given = getattr(self, key), key in self.model_fields_set
            if self.type in kinds and value is None:
                expected = _EXPECTED.get(key, "three numbers [x, y, z]")
                raise wrong(key, None, f"{expected} for a light of type {self.type!r}")
            if self.type not in _ALLOWED[key] and given and value is not None:
                shown = list(value) if isinstance(value, tuple) else value
                raise wrong(key, shown, f"no {key} for a light of type {self.type!r}")
        if self.direction is not None and not any(self.direction):
            raise wrong("direction", list(self.direction), "a vector that is not 0")
        if self.type == "image" and not np.linalg.norm(np.cross(_unit(self.direction), _unit(self.up))) > 1e-6:
            raise wrong("up", list(self.up), "a vector that is not 0, and not along direction")
        return self

    def found_in(self, folder: Path, origin: str, number: int) -> Light:
        """A copy whose file, where there is one, is a path that includes ``folder``. SceneError if it does not exist or
        is no picture. ``number``: of the light in its scene."""
        if self.file is None:
            return self
        path, where = folder / self.file, f"{origin}: light.{number}.file"
        if path.suffix.lower() not in IMAGES:
            raise SceneError(where, f"got {self.file!r}", "a picture (.exr, .png)")
        if not os.path.isfile(path):
            raise SceneError(where, f"got {self.file!r}, no such file", "a picture (.exr, .png)")
        return self.model_copy(update={"file": str(path)})

    def axes(self) -> np.ndarray:
        """Unit vectors [3, 3] of a spot or image light: right, up and forward, as seen from the light."""
        forward = _unit(self.direction)
        up = _unit(self.up) if self.type == "image" else np.eye(3)[int(np.argmin(np.abs(forward)))]
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(right, forward), forward])


def _unit(vector: Vector | None) -> np.ndarray:
    """Of unit length, whatever its length is; 0 stays 0."""
    array = np.asarray(vector, np.float64)
    array = array / max(float(np.abs(array).max()), 1e-300)
    return np.asarray(array / max(float(np.linalg.norm(array)), 1e-300))
