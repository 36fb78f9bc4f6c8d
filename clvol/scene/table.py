"""The base of every table of a scene: immutable, strict about types, with error messages that name the mistake.

A field's ``title`` says in one line what the key means. Its ``description`` says which values are expected, and is
also the last part of error messages. ``examples`` holds a value where there is no default. The scene reference and the
JSON schema (``clvol/scene/reference.py``) are made from these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from inspect import Parameter, Signature
from typing import TYPE_CHECKING, Annotated, Any, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
    WithJsonSchema,
    WrapValidator,
)
from pydantic_core import PydanticCustomError

from clvol.errors import SceneError
from clvol.scene.sizes import parse_size
from clvol.transfer.color_names import EXPECTED, NamedColor
from clvol.volume.volume import Volume

_KINDS: dict[type, str] = {dict: "table", list: "list"}
_LONGEST_KEY = 100  # longer keys get no "did you mean"
LARGEST_LENGTH = 1e30  # keeps the square of a coordinate's ratio to a voxel within a double


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)  # the type checker needs its name, which pydantic does not export


class _TableType(ModelMetaclass):
    """Turns the ValidationError of a direct call, such as Camera(...), into a SceneError."""

    def __call__(cls, *args: Any, **keys: Any) -> Any:
        if args and issubclass(cls, Table):
            raise _by_keyword(cls, args[0])
        try:
            return super().__call__(*args, **keys)
        except ValidationError as error:
            if not issubclass(cls, Table):
                raise
            raise scene_error(error, cls, "scene", cls.table_name()) from None


def _by_keyword(model: type[Table], value: Any) -> SceneError:
    """The error for a value that is passed by position."""
    name = model.__name__
    fields = [key for key in model.model_fields if key != "version"]
    what = f"got {shown(value)} by position"
    if isinstance(value, Mapping):
        return SceneError(f"clvol.{name}", what, f"keywords: clvol.{name}(**table)")
    return SceneError(f"clvol.{name}", what, f"keywords: clvol.{name}({fields[0]}=…)")


class Table(BaseModel, metaclass=_TableType):
    """One table of a scene. Raises SceneError for an unknown key, a wrong type or value."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        arbitrary_types_allowed=True,
        validate_default=False,
    )

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        super().__pydantic_init_subclass__(**options)
        cls.__signature__ = _readable_signature(cls)

    @classmethod
    def table_name(cls) -> str:
        """The name of the table in a scene file; empty for the scene itself."""
        return ""

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False):
        """A copy with the keys of ``update`` replaced and checked, as if built anew."""
        if not update:
            return super().model_copy(deep=deep)
        settings = {name: getattr(self, name) for name in self.model_fields_set}
        return type(self)(**{**settings, **update})


class _AllDefaults:
    """What ``help`` shows as the default of a key that is a table of its own."""

    def __init__(self, value: BaseModel) -> None:
        self._name = type(value).__name__

    def __repr__(self) -> str:
        return f"{self._name}()"


def _readable_signature(model: type[BaseModel]) -> Signature:
    """Names and defaults, as ``help`` shows them: annotations with validators in them fill a page."""
    parameters = []
    for name, field in model.model_fields.items():
        default = Parameter.empty if field.is_required() else field.default
        shown_default = _AllDefaults(default) if isinstance(default, BaseModel) else default
        parameters.append(Parameter(name, Parameter.KEYWORD_ONLY, default=shown_default))
    return Signature(parameters)


def wrong(key: str, got: Any, expected: str) -> PydanticCustomError:
    """The error that a model's validator raises. ``key`` is relative to the model, with dots between its parts."""
    return PydanticCustomError("scene", "{got}", {"key": key, "got": got, "expected": expected})


def shown(value: Any, limit: int = 60) -> str:
    """``value`` as an error message shows it: one line, not longer than ``limit`` characters."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, BaseModel):
        return f"a {type(value).__name__}"
    if isinstance(value, tuple):
        value = list(value)
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if isinstance(value, Volume):
        return f"a {value!r}".replace("a <Volume", "the Volume").removesuffix(">")
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # an integer with more digits than Python prints
        text = "an integer of thousands of digits"
    except RecursionError:
        text = f"a {_KINDS.get(type(value), 'value')} nested hundreds deep"
    return text if len(text) <= limit else text[: limit - 1] + "…"


def scene_error(
    error: ValidationError, model: type[BaseModel], file: str, table: str = ""
) -> SceneError:
    """The first mistake in ``error`` as a SceneError. Unknown keys come first, since they often cause the others."""
    mistakes = error.errors(include_url=False)
    mistake = next((m for m in mistakes if m["type"] == "extra_forbidden"), mistakes[0])
    path = [str(part) for part in mistake["loc"]]
    context = mistake.get("ctx", {})
    if mistake["type"] == "scene":
        path += [part for part in context["key"].split(".") if part]
        got, expected = context["got"], context["expected"]
        what = "missing" if got is None else f"got {shown(got)}"
    elif mistake["type"] == "extra_forbidden":
        keys = keys_of(_model_at(model, path[:-1]) or model)
        what = f"unknown key (got {shown(mistake['input'])})"
        expected = expected_key(path[-1], keys)
    elif mistake["type"] == "missing":
        what, expected = "missing", _described(model, path) or "a value"
    else:
        what = f"got {shown(mistake['input'])}"
        expected = _described(model, path) or mistake["msg"]
    if table:
        path.insert(0, table)
    where = ".".join(path)
    return SceneError(f"{file}: {where}" if where else file, what, expected)


def expected_key(key: str, keys: list[str]) -> str:
    """The ``expected`` part of the error for an unknown ``key``: all ``keys``, and the most similar one."""
    near = get_close_matches(key, keys, n=1) if len(key) <= _LONGEST_KEY else ()
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    return "one of " + ", ".join(keys) + hint


def keys_of(model: type[BaseModel]) -> list[str]:
    return list(model.model_fields)


def _model_at(model: type[BaseModel], path: list[str]) -> type[BaseModel] | None:
    """The model that the keys of ``path`` lead to, or None if they lead to no model."""
    for part in path:
        if part.isdecimal():
            continue
        field = model.model_fields.get(part)
        inner = None if field is None else model_in(field.annotation)
        if inner is None:
            return None
        model = inner
    return model


def model_in(annotation: Any) -> type[BaseModel] | None:
    """The model that a field's annotation names, alone or in a list or union; None if it names none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in get_args(annotation):
        if found := model_in(inner):
            return found
    return None


def _described(model: type[BaseModel], path: list[str]) -> str | None:
    """The description of the field that ``path`` leads to. For an item of a list it is that of the list."""
    names = [part for part in path if not part.isdecimal()]
    for end in range(len(names), 0, -1):
        owner = _model_at(model, names[: end - 1])
        field = None if owner is None else owner.model_fields.get(names[end - 1])
        if field is not None and field.description:
            return field.description
    return None


def plain(value: Any) -> Any:
    """Converts numpy scalars to Python numbers, and integers beyond the range of float to infinity."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, int) and not isinstance(value, bool):
        try:
            float(value)
        except OverflowError:
            return math.inf
    return value


def _plain_list(value: Any) -> Any:
    """Converts lists and arrays to tuples, the only type that a strict tuple field accepts."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(value) if isinstance(value, list) else value


Number = Annotated[float, BeforeValidator(plain)]
Whole = Annotated[int, BeforeValidator(plain)]
Positive = Annotated[Number, Field(gt=0)]
Fraction = Annotated[Number, Field(ge=0, le=1)]
Coordinate = Annotated[Number, Field(ge=-LARGEST_LENGTH, le=LARGEST_LENGTH)]
Length = Annotated[Number, Field(gt=0, le=LARGEST_LENGTH)]
Vector = Annotated[tuple[Coordinate, Coordinate, Coordinate], BeforeValidator(_plain_list)]


def _color(value: Any, check: Callable[[Any], Any]) -> Any:
    return _named(value, False) or check(_plain_list(value))


def _linear_color(value: Any, check: Callable[[Any], Any]) -> Any:
    return _named(value, True) or check(_plain_list(value))


def _named(value: Any, linear: bool) -> NamedColor | None:
    """The colour that a text names; None for a value that is no text."""
    if isinstance(value, NamedColor) and value.is_linear == linear:
        return value
    text = value.text if isinstance(value, NamedColor) else value
    if not isinstance(text, str):
        return None
    try:
        return NamedColor(text, linear)
    except ValueError as error:
        raise wrong("", text, str(error)) from None


def _stated_color(value: Any) -> Any:
    return value.text if isinstance(value, NamedColor) else value


COLOR = EXPECTED  # the description of a key of type Color
_component = {"type": "number", "minimum": 0, "maximum": 1}
_color_schema = WithJsonSchema(
    {"anyOf": [{"type": "array", "items": _component, "minItems": 3, "maxItems": 3}, {"type": "string"}]}
)
_Triple = tuple[Fraction, Fraction, Fraction]
# A name or "#rrggbb" is an sRGB colour whatever the color_space; ``NamedColor`` keeps the text.
Color = Annotated[_Triple, WrapValidator(_color), PlainSerializer(_stated_color), _color_schema]
# The same for keys in linear light.
LinearColor = Annotated[_Triple, WrapValidator(_linear_color), PlainSerializer(_stated_color), _color_schema]
AsTuple = BeforeValidator(_plain_list)


def _as_size(value: object) -> object:
    """Accepts a plain number of bytes, too."""
    plain = isinstance(value, int) and not isinstance(value, bool)
    return f"{value} B" if plain else value


def _is_size(text: str) -> str:
    parse_size(text)
    return text


Size = Annotated[str, BeforeValidator(_as_size), AfterValidator(_is_size)]
