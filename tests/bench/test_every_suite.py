"""Every suite of the bench, once and small: it measures, shows its table, draws its charts and keeps its result.

Suites that a test of their own runs smaller still (effects, pyramid; shaded and isosurface, where vtk is there) are
left out.
"""

from __future__ import annotations

import json

import pytest

from bench.__main__ import main

pytestmark = pytest.mark.slow

# name: the scenes that it is run on (none: those of its quick run), volumes that it needs
SUITES = {
    "sampling": (("aneurism",), ("aneurism.nrrd",)),
    "scaling": (("aneurism",), ("aneurism.nrrd",)),
    "startup": ((), ()),
    "convergence": ((), ()),
    "tradeoff": (("demo",), ()),
    "targets": (("aneurism",), ("aneurism.nrrd",)),
    "multiresolution": (("aneurism",), ("aneurism.nrrd",)),
    "devices": (("aneurism",), ("aneurism.nrrd",)),
    "workers": ((), ()),
    "slicing": ((), ("engine.nrrd",)),
    "coherence": ((), ("engine.nrrd",)),
    "supersampling": (("aneurism",), ("aneurism.nrrd",)),
    "random-peaks": ((), ("engine.nrrd",)),
    "gallery": (("tooth-layers",), ("tooth.nrrd",)),
}


@pytest.mark.parametrize("name", SUITES)
def test_a_quick_run_measures_shows_and_draws(name, device, shared_volume, tmp_path, monkeypatch, capsys):
    scenes, volumes = SUITES[name]
    for volume in volumes:
        shared_volume(volume)
    monkeypatch.setattr("bench.options.RESULTS", tmp_path)
    words = ["--scenes", ",".join(scenes)] if scenes else []
    assert main(["--quick", *words, name]) == 0, capsys.readouterr().out
    shown = capsys.readouterr().out
    kept = tmp_path / "quick" / f"{name}.json"
    assert json.loads(kept.read_text(encoding="utf-8"))["quick"]
    assert f"== {name}:" in shown and str(kept) in shown
