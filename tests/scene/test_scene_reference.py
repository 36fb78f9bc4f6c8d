"""The scene reference and the JSON schema: current, complete, and what the models accept."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from clvol.errors import SceneError
from clvol.scene import load_scene
from clvol.scene.load import tomllib
from clvol.scene.reference import reference_keys, scene_reference, scene_schema, table_names
from clvol.scene.scene import Scene

DATA = Path(__file__).resolve().parents[2] / "data"
HOW = "; update it by 'python -m clvol scene {}'"


def test_the_reference_is_current():
    assert (DATA / "scene-reference.toml").read_text(encoding="utf-8") == scene_reference(), HOW.format("--keys")


def test_the_schema_is_current():
    told = json.loads((DATA / "scene.schema.json").read_text(encoding="utf-8"))
    assert told == scene_schema(), HOW.format("--schema")


def test_the_reference_loads_and_states_the_defaults():
    scene = load_scene(DATA / "scene-reference.toml")
    for name in ("image", "integration", "material", "multiresolution", "pyramid", "gradient", "animation"):
        table = getattr(scene, name)
        assert table == type(table)(), name


@pytest.mark.parametrize("table", table_names())
def test_every_key_of_a_table_is_told_with_its_meaning(table):
    text = scene_reference(table)
    for name, key in reference_keys():
        if name == table:
            assert re.search(rf"^#? *{key} = |^#   {key}: \w", text, re.MULTILINE), key
    model = tomllib.loads(text)[table]
    assert model  # the table alone is TOML, too


def test_every_field_has_a_meaning_and_says_what_is_expected():
    def models(model):
        from clvol.scene.table import model_in

        for key, field in model.model_fields.items():
            yield f"{model.__name__}.{key}", field
            inner = model_in(field.annotation)
            if inner is not None:
                yield from models(inner)

    for name, field in models(Scene):
        assert field.title and field.title[0].isupper() and field.title.endswith("."), name
        assert field.description and not field.description.endswith("."), name
        assert len(field.title) < 120 and "\n" not in field.title, name


def test_a_table_that_is_not_there():
    with pytest.raises(SceneError, match="integration"):
        scene_reference("nothing")


def is_accepted(value, schema, whole) -> bool:
    """What the schema's types, keys, enumerations and bounds say about ``value``: all that ours uses."""
    schema = whole["$defs"][schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema
    if "anyOf" in schema:
        return any(is_accepted(value, choice, whole) for choice in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return value in schema.get("enum", [schema.get("const")])
    kind = schema.get("type")
    if kind == "object" and "properties" not in schema:  # keys of any table
        return isinstance(value, dict)
    if kind == "object":
        return isinstance(value, dict) and all(
            key in schema["properties"] and is_accepted(item, schema["properties"][key], whole)
            for key, item in value.items()
        ) and set(schema.get("required", ())) <= set(value)  # fmt: skip
    if kind == "array":
        items = schema.get("prefixItems")
        if not isinstance(value, list) or (items and len(items) != len(value)):
            return False
        return all(is_accepted(item, items[i] if items else schema["items"], whole) for i, item in enumerate(value))
    if kind in ("number", "integer"):
        whole_number = isinstance(value, int) and not isinstance(value, bool)
        right = whole_number or (kind == "number" and isinstance(value, float))
        return right and schema.get("minimum", value) <= value <= schema.get("maximum", value)
    types = {"string": str, "boolean": bool}
    return kind is None or isinstance(value, types[kind])


SCENES = sorted(path for path in DATA.glob("**/*.toml") if path.parent.name not in ("presets", "jobs"))


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_the_schema_accepts_every_scene_that_is_shipped(path):
    scene = tomllib.loads(path.read_text(encoding="utf-8"))
    schema = scene_schema()
    assert is_accepted(scene, schema, schema)


@pytest.mark.parametrize(
    "text",
    ["[image]\nwidht = 5\n", "[image]\nwidth = 0\n", '[integration]\nmethod = "fast"\n', "[camera]\nup = [0, 1]\n"],
)
def test_the_schema_refuses_what_the_scene_refuses(text, tmp_path):
    data = tomllib.loads('[volume]\nfile = "x.nrrd"\n' + text)
    schema = scene_schema()
    assert not is_accepted(data, schema, schema)
    with pytest.raises(SceneError):
        Scene.from_data(data, "scene", tmp_path)
