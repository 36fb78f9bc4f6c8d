"""[[animation.keyframe]]: the camera and values of a scene at a time."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from clvol.scene.table import Length, Number, Table, Vector, wrong

MOST_KEYFRAMES = 10000
_KEY = re.compile(r"[a-z_]+(\.[a-z0-9_]+)+")
_FIXED = (
    "version", "volume", "camera", "image", "animation", "compression", "field", "display", "overlay", "coherence",
)  # fmt: skip
_NUMBERS = "numbers, or lists and tables of numbers"


class KeyCamera(Table):
    """Where the camera is at the time of a keyframe. Keys that a keyframe leaves out are interpolated between those
    that have them; what none has is that of [camera]."""

    position: Vector | None = Field(
        None, title="Position of the eye.", description="[x, y, z] in world units", examples=[[0.0, 0.0, 500.0]]
    )
    target: Vector | None = Field(
        None, title="Position that is in the middle of the picture.", description="[x, y, z] in world units",
        examples=[[0.0, 0.0, 0.0]],
    )  # fmt: skip
    up: Vector | None = Field(
        None, title="Direction that is up in the picture.", description="[x, y, z], not parallel to the view",
        examples=[[0.0, 1.0, 0.0]],
    )  # fmt: skip
    fov_degrees: Annotated[Number, Field(gt=0, lt=180)] | None = Field(
        None, title="Vertical field of view.", description="an angle greater than 0 and less than 180", examples=[30.0]
    )
    height: Length | None = Field(
        None, title="Height of an orthographic view.", description="a world length greater than 0", examples=[250.0]
    )

    @classmethod
    def table_name(cls) -> str:
        return "camera"


def _values(given: Any) -> dict[str, Any]:
    """The values of ``set`` by key; tables of tables ("a.b" without quotes) are taken apart."""
    if not isinstance(given, dict):
        raise wrong("", given, "a table of keys of the scene and their values")
    found: dict[str, Any] = {}

    def take_apart(prefix: str, value: Any) -> None:
        if isinstance(value, dict) and value:
            for key, inner in value.items():
                take_apart(f"{prefix}.{key}" if prefix else str(key), inner)
        else:
            found[prefix] = value

    take_apart("", given)
    for key, value in found.items():
        if not _KEY.fullmatch(key) or key.split(".")[0] in _FIXED:
            expected = "a key such as 'noise.0.amplitude'; not of " + ", ".join(_FIXED)
            raise wrong("", key, expected)
        if not _is_numeric(value):
            raise wrong(key, value, _NUMBERS)
    return found


def _is_numeric(value: Any) -> bool:
    if isinstance(value, dict):
        return bool(value) and all(map(_is_numeric, value.values()))
    if isinstance(value, (list, tuple)):
        return bool(value) and all(map(_is_numeric, value))
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < float("inf")


def structure(value: Any) -> Any:
    """``value`` with its numbers left out: what must be equal for values to be interpolated."""
    if isinstance(value, dict):
        return {key: structure(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [structure(inner) for inner in value]
    return None


_Values = Annotated[dict[str, Any], BeforeValidator(_values), WithJsonSchema({"type": "object"})]


class Keyframe(Table):
    """What the scene is at one time: ``camera``, and ``set``, values of other keys as in ``--set``.

    Positions and targets move along Catmull-Rom splines, ``up`` along great circles, and all other numbers along
    monotone cubics, which do not leave the range of their values.
    """

    time: Number = Field(
        ge=-1e6, le=1e6, title="Time of the keyframe, in seconds.", description="seconds from -1e6 to 1e6",
        examples=[0.0],
    )  # fmt: skip
    camera: KeyCamera | None = Field(
        None, title="The camera at that time.", description="a table with the keys position, target, up, fov_degrees, "
        "height", examples=[{"position": [0.0, 0.0, 500.0]}],
    )  # fmt: skip
    set: _Values = Field(
        default_factory=dict, title="Values of other keys at that time, as in --set.",
        description="a table such as { \"noise.0.amplitude\" = 20.0 }", examples=[{"noise.0.amplitude": 20.0}],
    )  # fmt: skip

    @classmethod
    def table_name(cls) -> str:
        return "keyframe"

    @model_validator(mode="after")
    def _says_something(self) -> Keyframe:
        if not self.set and (self.camera is None or not self.camera.model_fields_set):
            raise wrong("set", None, "a camera or values to set")
        return self


def check_keyframes(keyframes: tuple[Keyframe, ...]) -> None:
    """Raises the error of a model's validator if ``keyframes`` are too many, not in order, or do not go together."""
    if len(keyframes) > MOST_KEYFRAMES:
        raise wrong("keyframe", len(keyframes), f"at most {MOST_KEYFRAMES} keyframes")
    first: dict[str, Any] = {}
    for i, keyframe in enumerate(keyframes):
        if i and keyframe.time <= keyframes[i - 1].time:
            raise wrong(f"keyframe.{i}.time", keyframe.time, f"ascending times, here more than {keyframes[i - 1].time}")
        for key, value in keyframe.set.items():
            if structure(first.setdefault(key, value)) != structure(value):
                raise wrong(f"keyframe.{i}.set.{key}", value, "as many numbers as in the keyframes before")
