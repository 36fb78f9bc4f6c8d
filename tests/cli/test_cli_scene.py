"""clvol scene: the keys of a scene file."""

from __future__ import annotations

import json

from clvol.scene.reference import scene_reference, scene_schema, table_names


def test_all_keys(run):
    outcome = run("scene", "--keys")
    assert (outcome.status, outcome.err, outcome.out) == (0, "", scene_reference())


def test_the_keys_of_one_table(run):
    outcome = run("scene", "--keys", "pyramid")
    assert (outcome.status, outcome.out) == (0, scene_reference("pyramid"))
    assert "epsilon = 0.01" in outcome.out and "[integration]" not in outcome.out


def test_the_schema(run):
    assert json.loads(run("scene", "--schema").out) == scene_schema()


def test_wrong_usage(refused):
    assert refused(2, "scene") == "clvol scene: neither --keys nor --schema, expected one of --keys and --schema"
    assert refused(2, "scene", "--keys", "--schema").startswith("clvol scene: --keys and --schema, expected one")
    assert refused(2, "scene", "--schema", "image").startswith("clvol scene: TABLE: got 'image' beside --schema")
    line = refused(2, "scene", "--keys", "imag")
    assert line.startswith("scene: got the table 'imag', expected one of ") and line.endswith(table_names()[-1])
