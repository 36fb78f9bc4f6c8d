"""Scenes that call for an effect, and scenes that state one without consequence."""

from __future__ import annotations

import numpy as np

from clvol import TransferFunction, Volume
from clvol.scene import ImageSettings, Scene
from helpers.small_scenes import SMOOTH, waves

ARRAY = waves((8, 9, 10), np.uint8)  # 0 to 255
VOLUME = Volume(ARRAY)
WHITE = [1.0, 1.0, 1.0]
SUN = {"type": "directional", "direction": (0, 0, 1)}
SPOT = {"type": "spot", "position": (5, 5, -9), "direction": (0, 0, 1)}
CLEAR = TransferFunction([0, 255, 400], [0, 0, 1], [WHITE] * 3)  # transparent over 0 to 255
LABELS = Volume((ARRAY > 128).astype(np.uint8))


def scene_with(volume=VOLUME, function=SMOOTH, **tables):
    tables = {"image": ImageSettings(width=8, height=8), **tables}
    return Scene(volume=volume, transfer_function=function, **tables).resolve()


POINTS = [{"value": 0.0, "opacity": 0.3, "color": WHITE}]
FADING = {"points": [{"magnitude": 0, "opacity": 0}, {"magnitude": 5, "opacity": 1}]}
# (tables of a scene, effects that they call for beside emission-absorption)
CALLED = [
    ({}, []),
    ({"light": [SUN]}, ["lighting", "specular", "gradients"]),
    ({"light": [SUN], "material": {"specular": 0.0}}, ["lighting", "gradients"]),
    ({"light": [SUN], "material": {"specular": 0.0},
      "gradient": {"operator": "sobel", "storage": "on-the-fly"}},
     ["lighting", "gradients", "sobel gradients"]),
    ({"light": [SUN], "gradient": {"storage": "precomputed"}, "material": {"specular": 0.0}},
     ["lighting", "gradients", "precomputed gradients"]),
    ({"light": [SUN], "shadow": {}},
     ["lighting", "specular", "shadows", "gradients"]),
    ({"light": [SUN], "shadow": {"scattering": 0.4}},
     ["lighting", "specular", "shadows", "scattering", "gradients"]),
    ({"ambient_occlusion": {"distance": 3.0}}, ["ambient occlusion"]),
    ({"ambient_occlusion": {"distance": 3.0}, "isosurface": [{"value": 100.0}]},
     ["isosurfaces", "gradients", "ambient occlusion"]),
    ({"light": [SPOT]}, ["lighting", "specular", "spot lights", "gradients"]),
    ({"isosurface": [{"value": 100.0}]}, ["isosurfaces"]),
    ({"isosurface": [{"value": 100.0, "opacity": 0.0, "refraction": 1.5}]},
     ["isosurfaces", "refraction", "gradients"]),
    ({"refraction": {"points": [{"value": 0.0, "index": 1.0}, {"value": 90.0, "index": 1.2}]}},
     ["continuous refraction", "gradients"]),
    ({"clip": [{"point": (3.0, 0, 0), "normal": (1.0, 0, 0)}]}, ["clipping"]),
    ({"clip": [{"type": "box", "lower": (1, 1, 1), "upper": (5, 5, 5)}]}, ["clipping"]),
    ({"clip": [{"type": "sphere", "center": (4, 4, 4), "radius": 3, "keep": "outside"}]},
     ["clipping"]),
    ({"gradient_opacity": FADING}, ["gradients", "gradient opacity"]),
    ({"directional_opacity": {"points": [{"derivative": 0, "opacity": 0.5}]}},
     ["gradients", "directional opacity"]),
    ({"transfer_layer": [{"magnitude": 3.0, "points": POINTS}]},
     ["gradients", "two-dimensional transfer function"]),
    ({"field": [{"file": LABELS, "role": "label", "labels": [{"label": 1, "color": WHITE}]}]},
     ["label field"]),
    ({"field": [{"file": VOLUME, "role": "density", "points": POINTS}]}, ["density field"]),
    ({"field": [{"file": LABELS, "role": "mask"}]}, ["mask field"]),
    ({"noise": [{"target": "value", "amplitude": 3.0}]}, ["noise"]),
    ({"noise": [{"target": "fur", "amplitude": 3.0, "root": 200.0, "tip": 90.0}]}, ["gradients", "fur"]),
    ({"animation": {"time": 0.5, "cycle": 0.5}}, ["colour cycling"]),
    ({"depth_cue": {}}, ["depth cueing"]),
    ({"integration": {"filter": "nearest"}}, ["nearest filter"]),
    ({"integration": {"filter": "catmull-rom"}}, ["catmull-rom filter"]),
    ({"integration": {"filter": "lanczos3"}}, ["lanczos3 filter"]),
    ({"integration": {"filter": "table", "filter_table": [1.0, 0.5, 0.1, 0.0]}}, ["table filter"]),
    ({"integration": {"filter": "cubic", "prefilter": True}}, ["cubic filter", "prefilter"]),
    ({"integration": {"minification": "levels"}}, ["minification"]),
]  # fmt: skip

DARK = SUN | {"intensity": 0.0}
IDLE_LABEL = {"file": LABELS, "role": "label", "labels": [{"label": 7, "color": WHITE}]}
FAR = Volume(LABELS.data, origin=(100.0, 0.0, 0.0))
ONES = Volume(np.ones(ARRAY.shape, np.float32))
# (tables, effect, why it is not called for)
IDLE = [
    ({}, "lighting", "the scene has no light"),
    ({"light": [DARK]}, "lighting", "every light is black or of intensity 0"),
    ({"light": [SUN | {"color": (0, 0, 0)}]}, "lighting", "every light is black"),
    ({"light": [SUN], "material": {"ambient": 1, "diffuse": 0, "specular": 0}},
     "lighting", "ambient is 1, diffuse and specular are 0"),
    ({"light": [SUN], "material": {"specular": 0}}, "specular", "specular is 0"),
    ({"light": [SUN | {"type": "headlight", "direction": None}], "shadow": {}},
     "shadows", "no light that shines casts a shadow"),
    ({"light": [SUN | {"casts_shadow": False}], "shadow": {}},
     "shadows", "no light that shines casts a shadow"),
    ({"light": [SUN], "material": {"diffuse": 0, "specular": 0}, "shadow": {}},
     "shadows", "the shadowing light reaches nothing lit"),
    ({"light": [DARK], "shadow": {"scattering": 0.5}},
     "scattering", "the shadowing light reaches nothing lit"),
    ({"light": [SUN], "shadow": {"method": "rays", "bound": 1.0}}, "shadows", "above the bound 1"),
    ({"light": [SUN], "shadow": {}}, "scattering", "scattering is 0"),
    ({"light": [SUN], "shadow": {"scattering": 0.5, "scatter_color": (0, 0, 0), "cone_degrees": 0}},
     "scattering", "the cone is 0"),
    ({"isosurface": [{"value": 300.0}]},
     "isosurfaces", "iso-value 300 lies outside the data's range 0 to 255"),
    ({"isosurface": [{"value": 3.0, "opacity": 0.0}]}, "isosurfaces", "at 3 is transparent"),
    ({"isosurface": [{"value": 300.0}, {"value": -1.0}]},
     "isosurfaces", "iso-value 300 lies outside the data's range 0 to 255; iso-value -1 lies"),
    ({"isosurface": [{"value": 3.0}]}, "refraction", "every isosurface's refraction is 1"),
    ({"isosurface": [{"value": 3.0, "refraction": 2.0}]}, "refraction", "is opaque or not there"),
    ({"clip": [{"point": (-50, 0, 0), "normal": (1, 0, 0)}]},
     "clipping", "the clip plane does not meet the volume"),
    ({"clip": [{"type": "box", "lower": (-1, -1, -1), "upper": (50, 50, 50)}]},
     "clipping", "the clip box holds the whole volume"),
    ({"clip": [{"type": "box", "lower": (20, 0, 0), "upper": (30, 9, 9), "keep": "outside"}]},
     "clipping", "the clip box does not meet the volume"),
    ({"clip": [{"type": "sphere", "center": (4, 4, 4), "radius": 20}]},
     "clipping", "the clip sphere holds the whole volume"),
    ({"clip": [{"type": "sphere", "center": (-4, 4, 4), "radius": 3.9, "keep": "outside"}]},
     "clipping", "the clip sphere does not meet the volume"),
    ({"gradient_opacity": {"points": [{"magnitude": 0, "opacity": 1}]}},
     "gradient opacity", "the gradient opacity is 1 everywhere"),
    ({"gradient_opacity": {"points": [{"magnitude": 900, "opacity": 1},
                                      {"magnitude": 1000, "opacity": 0}]}},
     "gradient opacity", "is 1 for every gradient of the volume"),
    ({"directional_opacity": {"points": [{"derivative": 2, "opacity": 1}]}},
     "directional opacity", "the directional opacity is 1 everywhere"),
    ({"field": [IDLE_LABEL]}, "label field", "none of the labels occurs in the field"),
    ({"field": [IDLE_LABEL | {"file": FAR, "labels": [{"label": 1, "color": WHITE}]}]},
     "label field", "the field does not meet the volume"),
    ({"field": [{"file": VOLUME, "role": "density", "points": [POINTS[0] | {"opacity": 0.0}]}]},
     "density field", "the field's points are transparent over its range 0 to 255"),
    ({"field": [{"file": FAR, "role": "density", "points": POINTS}]},
     "density field", "the field does not meet the volume"),
    ({"field": [{"file": ONES, "role": "mask"}]},
     "mask field", "the mask is above 0.5 all over the volume"),
    ({"field": [{"file": ONES, "role": "mask", "threshold": 2, "keep": "below"}]},
     "mask field", "the mask is below 2 all over the volume"),
    ({"noise": [{"target": "value", "amplitude": 0.0}]}, "noise", "the noise's amplitude is 0"),
    ({"animation": {"time": 4.0, "cycle": 0.0}}, "colour cycling", "the cycle is 0"),
    ({"animation": {"time": 4.0, "cycle": 0.5}}, "colour cycling", "has completed 2 periods"),
    ({"depth_cue": {"strength": 0.0}}, "depth cueing", "the depth cue's strength is 0"),
    ({"depth_cue": {"start": 500.0, "end": 501.0}},
     "depth cueing", "the depth cue starts at 500, beyond the volume's farthest corner"),
    ({"gradient": {"operator": "sobel"}}, "sobel gradients", "nothing needs gradients"),
    ({"light": [SUN], "gradient": {"operator": "sobel"}, "integration": {"filter": "cubic"}},
     "sobel gradients", "the filter 'cubic' has a derivative of its own"),
    ({"ambient_occlusion": {"intensity": 0.0}}, "ambient occlusion", "the ambient occlusion's intensity is 0"),
    ({"ambient_occlusion": {}, "integration": {"compositing": "maximum"}},
     "ambient occlusion", "maximum intensity projection is not lit"),
    ({"light": [SUN]}, "spot lights", "the scene has no spot light"),
    ({"light": [SUN]}, "image lights", "the scene has no image light"),
    ({"light": [SUN, SPOT | {"cone_degrees": 180.0, "penumbra": 0.0}]}, "spot lights", "in all directions alike"),
    ({"light": [SPOT], "material": {"diffuse": 0, "specular": 0}}, "spot lights", "diffuse and specular are 0"),
    ({"light": [SPOT | {"cone_degrees": 0.0}]}, "spot lights", "a spot whose cone is 0"),
    ({}, "continuous refraction", "the scene has no refraction"),
    ({"refraction": {"points": [{"value": 300.0, "index": 1.0}, {"value": 400.0, "index": 1.2}]}},
     "continuous refraction", "the same for all values of the volume"),
    ({"refraction": {"points": [{"value": 0.0, "index": 1.0}, {"value": 90.0, "index": 1.2}]},
      "function": CLEAR}, "continuous refraction", "nothing of the volume is visible"),
    ({"integration": {"minification": "levels"}, "function": CLEAR}, "minification", "shows nothing of the volume"),
]  # fmt: skip
