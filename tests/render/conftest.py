"""A context on each device, kept for the session so that nothing is compiled twice."""

from __future__ import annotations

import pytest

from clvol.opencl.context import DeviceContext


@pytest.fixture(scope="session")
def contexts():
    """One context a device, kept for the session so that nothing is compiled twice."""
    made: dict = {}

    def context_of(device) -> DeviceContext:
        if device not in made:
            made[device] = DeviceContext(device)
        return made[device]

    return context_of


@pytest.fixture
def context(device, contexts) -> DeviceContext:
    return contexts(device)
