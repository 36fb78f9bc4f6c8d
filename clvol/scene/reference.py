"""The reference of scene keys and the JSON schema for editors, made from the models' own descriptions.

``data/scene-reference.toml`` and ``data/scene.schema.json`` hold what these functions return; a test compares them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from clvol.errors import SceneError
from clvol.scene.scene import Scene
from clvol.scene.table import Table, model_in
from clvol.scene.write import format_value

_HEAD = """\
# Every key of a scene file. Each comment gives the meaning of a key, then the values that are expected and the
# default. A key that is commented out has no default, or does not go with the others of its table.
# Made by `clvol scene --keys`; to be read, not to be rendered."""


def table_names() -> tuple[str, ...]:
    """The names of all tables, in the order of the scene file."""
    return tuple(name for name in Scene.model_fields if name != "version")


def scene_reference(table: str | None = None) -> str:
    """Every key of a scene, or of one ``table``, as the text of a scene file with comments.

    The text of all tables loads as a scene. Raises SceneError if ``table`` is no table.
    """
    if table is None:
        parts = [_HEAD, "version = 1", *(_table_text(name) for name in table_names())]
        return "\n\n".join(parts) + "\n"
    if table not in table_names():
        raise SceneError("scene", f"got the table {table!r}", "one of " + ", ".join(table_names()))
    return _table_text(table) + "\n"


def reference_keys() -> list[tuple[str, str]]:
    """(table, key) of every key, including the keys of points and labels."""
    return [(name, key) for name in table_names() for key, _ in _keys(_model_of(name))]


def override_keys() -> list[str]:
    """TABLE.KEY of every key, in the form of ``--set``; a list of tables is represented by its first table."""
    keys = []
    for name in table_names():
        table = f"{name}.0" if _is_list(Scene.model_fields[name]) else name
        keys += [f"{table}.{key}" for key in _model_of(name).model_fields]
    return keys


def scene_schema() -> dict[str, Any]:
    """The JSON schema of a scene file (draft 2020-12), for editors that complete and check TOML."""
    schema = _cleaned(Scene.model_json_schema())
    models: list[type[BaseModel]] = [Scene, *_models()]
    for model in models:
        part = schema if model is Scene else schema["$defs"][model.__name__]
        part["description"] = " ".join((model.__doc__ or "").split("\n\n")[0].replace("``", "").split())
        for key, field in model.model_fields.items():
            known = part["properties"][key]
            known.pop("title", None)
            known.pop("default", None)
            if (default := _default(field)) is not None:
                known["default"] = default
            known["description"] = f"{field.title} Expected: {field.description}."
    schema["title"] = "clvol scene"
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    return schema


def _table_text(name: str) -> str:
    field, model = Scene.model_fields[name], _model_of(name)
    shown = _shown(model)
    lines = [f"# {field.title}", f"[[{name}]]" if _is_list(field) else f"[{name}]"]
    for key, inner in model.model_fields.items():
        value = _example(inner)
        lines += [f"# {inner.title}", f"#   {_expectation(inner)}"]
        if (item := model_in(inner.annotation)) is not None:
            for part, described in _keys(item):
                lines.append(f"#   {part}: {described.title} {_expectation(described)}")
        stated = f"{key} = {format_value(value)}"
        lines += [f"{'' if key in shown else '# '}{line}" for line in stated.splitlines()]
    return "\n".join(lines)


def _expectation(field: FieldInfo) -> str:
    default = _default(field)
    if field.is_required():
        return f"{field.description}; required"
    return f"{field.description}; " + ("no default" if default is None else f"default {format_value(default)}")


def _shown(model: type[Table]) -> set[str]:
    """The keys that are not commented out: those with defaults, and the fewest others that make the table valid."""
    fields = model.model_fields
    without = [key for key, field in fields.items() if not field.is_required() and _default(field) is None]
    always = [key for key in fields if key not in without]
    for left_out in range(len(always) + 1):
        for added in range(len(without) + 1):
            for extra in combinations(without, added):
                for fewer in combinations(always, left_out):
                    keys = {*always, *extra} - set(fewer)
                    if _is_valid(model, {key: _example(fields[key]) for key in keys}):
                        return keys
    raise AssertionError(f"no valid example of {model.__name__}")


def _is_valid(model: type[Table], values: dict[str, Any]) -> bool:
    try:
        model(**values)
    except SceneError:
        return False
    return True


def _example(field: FieldInfo) -> Any:
    default = _default(field)
    return field.examples[0] if default is None and field.examples else default


def _default(field: FieldInfo) -> Any:
    """The default as a scene file would state it; None if there is none or if it is a whole table."""
    value = None if field.default is PydanticUndefined else field.default
    if isinstance(value, BaseModel) or value == ():
        return None
    return list(value) if isinstance(value, tuple) else value


def _keys(model: type[BaseModel]) -> Iterator[tuple[str, FieldInfo]]:
    for key, field in model.model_fields.items():
        yield key, field
        if (inner := model_in(field.annotation)) is not None:
            yield from _keys(inner)


def _models() -> list[type[BaseModel]]:
    """The models of all tables, and of the lists inside them."""
    found: dict[type[BaseModel], None] = {}

    def add(model: type[BaseModel]) -> None:
        found[model] = None
        for field in model.model_fields.values():
            if (inner := model_in(field.annotation)) is not None:
                add(inner)

    for name in table_names():
        add(_model_of(name))
    return list(found)


def _model_of(name: str) -> type[Table]:
    model = model_in(Scene.model_fields[name].annotation)
    assert model is not None and issubclass(model, Table), name
    return model


def _is_list(field: FieldInfo) -> bool:
    return get_origin(field.annotation) is tuple and bool(get_args(field.annotation))


_BOUNDS = {"ge": "minimum", "le": "maximum", "gt": "exclusiveMinimum", "lt": "exclusiveMaximum"}


def _cleaned(value: Any) -> Any:
    """A schema without the type null, which TOML does not have, and with bounds by their names in JSON schema."""
    if isinstance(value, list):
        return [_cleaned(item) for item in value]
    if not isinstance(value, dict):
        return value
    if "anyOf" in value:
        choices = [item for item in value["anyOf"] if item != {"type": "null"}]
        rest = {key: item for key, item in value.items() if key != "anyOf"}
        value = rest | choices[0] if len(choices) == 1 else rest | {"anyOf": choices}
    return {
        _BOUNDS.get(key, key): _cleaned(item)
        for key, item in value.items()
        if not (key == "default" and item is None)
    }
