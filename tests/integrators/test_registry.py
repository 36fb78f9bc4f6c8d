"""The registry of integrators, and what each of them promises."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import get_args

import pytest
from helpers.small_scenes import make_scene, waves

from clvol.errors import SceneError
from clvol.integrators import base
from clvol.integrators.registry import NAMES, check_scene, integrator_named, integrator_of
from clvol.scene.integration import Integration


def members(protocol) -> dict[str, inspect.Signature | None]:
    names = [name for name in {*vars(protocol), *protocol.__annotations__} if not name.startswith("_")]
    return {name: inspect.signature(f) if callable(f := getattr(protocol, name, None)) else None for name in names}


def test_a_scene_may_name_every_integrator_and_no_other():
    assert set(get_args(Integration.model_fields["method"].annotation)) == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_each_has_what_the_protocol_says_with_the_same_parameters(name):
    integrator = integrator_named(name)
    assert integrator.name == name and integrator.tuned_as in NAMES
    for member, signature in members(base.Integrator).items():
        have = getattr(integrator, member)
        if signature is not None:
            assert list(inspect.signature(have).parameters) == list(signature.parameters)[1:], member


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_is_rendered_by_the_integrator_that_it_names(name):
    resolved = make_scene(waves((7, 8, 9)), method=name)
    check_scene(resolved)
    assert integrator_of(resolved) is integrator_named(name)
    assert integrator_of(resolved).device_bytes(resolved.volume, resolved) > 0


def test_an_unknown_name_is_an_error_that_lists_the_known_ones():
    resolved = make_scene(waves((7, 8, 9)))
    resolved = replace(resolved, integration=Integration.model_construct(method="dowsing"))
    with pytest.raises(SceneError, match="integration.method: got 'dowsing', expected 'raycast' or"):
        check_scene(resolved)


def test_what_is_kept_is_made_once_and_closed_when_it_goes():
    class Kept:
        closed = False

        def close(self):
            self.closed = True

    gone = []
    shared = base.Shared(None, gone.append)
    first = shared.keep("kind", 1, Kept, 2)
    assert shared.keep("kind", 1, Kept, 2) is first and shared.keep("other kind", 1, Kept, 2) is not first
    shared.keep("kind", 2, Kept, 2)
    shared.keep("kind", 3, Kept, 2)
    assert first.closed and gone == [first]
    shared.close()
    assert len(gone) == 4 and all(kept.closed for kept in gone)
