"""Renderers whose devices have processes of their own."""

from __future__ import annotations

import pytest

from clvol import Renderer
from clvol.opencl.devices import report_of
from clvol.render import device_group


@pytest.fixture
def halves(device) -> list[str]:
    """Two parts of the device, or the device alone, which then has no other."""
    report = report_of(device)
    if report.compute_units < 2:
        pytest.skip("the device has one compute unit, which cannot be divided")
    return [f"{report.name}:{k}/2" for k in (1, 2)]


@pytest.fixture
def isolated(monkeypatch):
    """``isolated(scene, names)``: a Renderer."""
    opened = []
    monkeypatch.setattr(device_group, "_LEAST_TILES", 1)

    def make(made, names) -> Renderer:
        opened.append(Renderer(made, devices=names, isolate=True))
        return opened[-1]

    yield make
    monkeypatch.undo()
    for each in opened:
        each.close()
