"""The gallery's scenes: what each is there to show is called for, and shows."""

from __future__ import annotations

from dataclasses import replace

import pytest
from helpers.paths import ROOT
from helpers.small_scenes import picture

from clvol import load_scene
from clvol.features import called_for, reduced

GALLERY = ROOT / "bench" / "gallery"
SHOWN = {
    "inia19-labels": "label field",
    "tooth-layers": "two-dimensional transfer function",
    "cthead-gradient": "gradient opacity",
}


@pytest.mark.parametrize("name", SHOWN)
def test_a_scene_of_the_gallery_shows_its_effect(context, shared_volume, name):
    shared_volume(name.split("-")[0] + ".nrrd")
    resolved = load_scene(GALLERY / f"{name}.toml").resolve()
    assert SHOWN[name] in called_for(resolved)
    small = resolved.image.model_copy(update={"width": 24, "height": 24})
    resolved = reduced(replace(resolved, image=small))
    rgba = picture(context, resolved).rgba
    others = replace(resolved, fields=(), transfer_layers=(), gradient_opacity=None)
    assert 0.05 < rgba[..., 3].mean() < 0.9
    assert abs(rgba - picture(context, others).rgba).mean() > 0.01
