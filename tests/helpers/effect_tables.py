"""Every effect that a scene may state, each as the tables that ask for it.

Tables are made for a volume: values are shares of its range, places shares of its extent.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from clvol.volume import Volume

Tables = dict[str, Any]
LIGHT = {"type": "directional", "direction": [-0.45, -0.8, -0.4]}
HEADLIGHT = {"type": "headlight"}
_SKY_ROWS = 32  # of the environment's picture


@dataclass(frozen=True)
class Place:
    """The volume and the scales that tables are made of, and a folder for files.

    ``lower``, ``upper``: of the domain, world [3]. ``edge``: its longest edge. ``slope``: the
    value's whole range over eight of the smallest voxel edges, value per world length.
    """

    volume: Volume
    folder: Path
    lower: np.ndarray = dataclasses.field(init=False)
    upper: np.ndarray = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        corners = self.volume.grid.world_corners()
        object.__setattr__(self, "lower", corners.min(axis=0))
        object.__setattr__(self, "upper", corners.max(axis=0))

    @property
    def edge(self) -> float:
        return float((self.upper - self.lower).max())

    @property
    def slope(self) -> float:
        low, high = self.volume.value_range
        return float(high - low) / (8.0 * self.volume.grid.smallest_edge)

    def value(self, share: float) -> float:
        """The value at ``share`` of the range: 0 its low end, 1 its high end."""
        low, high = self.volume.value_range
        return float(low) + share * float(high - low)

    def point(self, x: float, y: float, z: float) -> list[float]:
        """World coordinates at shares of the extent: 0.5 each is the centre."""
        return (self.lower + np.array([x, y, z]) * (self.upper - self.lower)).tolist()

    def field(self, of: Callable[..., np.ndarray], dtype: str, count: int = 25) -> Volume:
        """A volume over the same place, ``count`` voxels along each axis: ``of(x, y, z)`` of shares
        of the extent."""
        from clvol import Volume

        shares = np.linspace(0.0, 1.0, count)
        z, y, x = np.meshgrid(shares, shares, shares, indexing="ij")
        spacing = np.maximum((self.upper - self.lower) / (count - 1), 1e-9 * self.edge)
        data = np.ascontiguousarray(of(x, y, z).astype(dtype))
        return Volume(data, spacing=tuple(spacing), origin=tuple(self.lower))

    def sky(self, layout: str) -> str:
        """An EXR file of a bright upper half with a sun in it and a dim lower one; written once."""
        path = self.folder / f"sky-{layout}.exr"
        if not path.exists():
            _write_exr(path, _latlong_sky() if layout == "latlong" else _cube_sky())
        return str(path.resolve())


@dataclass(frozen=True)
class EffectScene:
    """``tables(place)`` asks for the effect, and for what it needs, over a scene without any.
    ``over``: the effect that it is built on, where that is not the plain scene."""

    name: str
    group: str
    tables: Callable[[Place], Tables]
    over: str | None = None


def with_tables(settings: Mapping[str, Any], tables: Mapping[str, Any]) -> Tables:
    """``settings`` (tables by name, as ``Scene`` takes them) with ``tables`` over them: a table's
    keys replace those of the same name, lists of tables are joined, all else replaces."""
    made = dict(settings)
    for name, table in tables.items():
        before = made.get(name)
        if isinstance(before, Mapping) and isinstance(table, Mapping):
            made[name] = {**before, **table}
        elif isinstance(before, (list, tuple)) and isinstance(table, (list, tuple)):
            made[name] = [*before, *table]
        else:
            made[name] = table
    return made


def by_name(name: str) -> EffectScene:
    """Of EFFECTS or UNUSED; KeyError for none of them."""
    return {effect.name: effect for effect in (*EFFECTS, *UNUSED)}[name]


def _fixed(**tables: Any) -> Callable[[Place], Tables]:
    return lambda place: tables


def _lit(**tables: Any) -> Callable[[Place], Tables]:
    return _fixed(light=[LIGHT], **tables)


def _point_light(place: Place) -> Tables:
    return {"light": [{"type": "point", "position": place.point(1.6, 1.8, 1.5)}]}


def _three_lights(place: Place) -> Tables:
    dim = [{**LIGHT, "intensity": 0.5}, {**HEADLIGHT, "intensity": 0.3}]
    return {"light": [*dim, {**_point_light(place)["light"][0], "intensity": 0.4}]}


def _surfaces(place: Place) -> Tables:
    shown = (
        (0.3, 0.3, [0.8, 0.5, 0.3]), (0.45, 0.5, [0.4, 0.7, 0.8]), (0.75, 0.9, [0.9, 0.9, 0.8])
    )  # fmt: skip
    return {"light": [LIGHT], "isosurface": [
        {"value": place.value(at), "opacity": opacity, "color": color, "back_color": color[::-1]}
        for at, opacity, color in shown
    ]}  # fmt: skip


def _surface(place: Place, **more: Any) -> Tables:
    return {"light": [LIGHT], "isosurface": [{"value": place.value(0.45), **more}]}


def _environment(layout: str, **more: Any) -> Callable[[Place], Tables]:
    return lambda place: {"environment": {"file": place.sky(layout), "layout": layout, **more}}


def _gradient_opacity(place: Place) -> Tables:
    rising = [(0.0, 0.1), (0.3, 0.6), (1.0, 1.0)]
    points = [{"magnitude": m * place.slope, "opacity": o} for m, o in rising]
    return {"gradient_opacity": {"points": points}}


def _directional_opacity(place: Place) -> Tables:
    falling = [(0.0, 1.0), (0.5, 0.4), (1.0, 0.2)]
    points = [{"derivative": d * place.slope, "opacity": o} for d, o in falling]
    return {"directional_opacity": {"points": points}}


def _two_layers(place: Place) -> Tables:
    edge = [(0.1, 0.0, [0.9, 0.3, 0.1]), (0.3, 0.1, [0.9, 0.6, 0.2]), (1.0, 0.4, [1.0, 0.9, 0.7])]
    layers = [(0.3, 0.3), (1.0, 1.0)]
    return {"transfer_layer": [
        {"magnitude": magnitude * place.slope, "points": [
            {"value": place.value(at), "opacity": share * opacity, "color": color}
            for at, opacity, color in edge
        ]}
        for magnitude, share in layers
    ]}  # fmt: skip


def _label_field(place: Place) -> Tables:
    labels = place.field(lambda x, y, z: np.floor(2.99 * x) + 3 * np.floor(1.99 * y), "uint8")
    colors = ([0.9, 0.3, 0.2], [0.3, 0.8, 0.3], [0.3, 0.4, 0.9], [0.9, 0.8, 0.2])
    listed = [{"label": i, "color": c, "opacity": 1.0 - 0.2 * i} for i, c in enumerate(colors)]
    return {"field": [{"file": labels, "role": "label", "labels": listed}]}


def _density_field(place: Place) -> Tables:
    def ball(x, y, z):
        return 1.0 - 2.5 * np.sqrt((x - 0.6) ** 2 + (y - 0.6) ** 2 + (z - 0.5) ** 2)

    points = [
        {"value": 0.0, "opacity": 0.0, "color": [0.2, 0.4, 0.9]},
        {"value": 1.0, "opacity": 0.05, "color": [0.5, 0.8, 1.0]},
    ]
    field = place.field(ball, "float32")
    return {"field": [{"file": field, "role": "density", "points": points}]}


def _mask_field(place: Place) -> Tables:
    field = place.field(lambda x, y, z: x + y + z - 1.2, "float32")
    return {"field": [{"file": field, "role": "mask", "threshold": 0.0}]}


def _clip_plane(place: Place) -> Tables:
    return {"clip": [{"point": place.point(0.5, 0.5, 0.6), "normal": [-0.3, 0.1, -1.0]}]}


def _clip_box(place: Place) -> Tables:
    corner = {"lower": place.point(0.5, 0.5, 0.5), "upper": place.point(1.2, 1.2, 1.2)}
    return {"clip": [{"type": "box", **corner, "keep": "outside"}]}


def _clip_sphere(place: Place) -> Tables:
    ball = {"center": place.point(0.5, 0.5, 0.5), "radius": 0.45 * place.edge}
    return {"clip": [{"type": "sphere", **ball, "keep": "inside"}]}


def _noise(target: str, octaves: int = 1) -> Callable[[Place], Tables]:
    def tables(place: Place) -> Tables:
        reach = 0.02 * place.edge if target == "coordinate" else place.value(0.1) - place.value(0.0)
        return {"noise": [{"target": target, "amplitude": reach, "octaves": octaves, "seed": 1}]}

    return tables


def _shadow(**keys: Any) -> Callable[[Place], Tables]:
    return _lit(shadow=keys)


_SHADED = "directional light"
_SCATTER = {"method": "volume", "scattering": 0.5, "scatter_color": [1.0, 0.8, 0.6]}
_LIGHT, _FILTER, _SURFACE, _SKY, _SHADOW = (
    "light", "filter", "surface", "environment", "shadow"
)  # fmt: skip
_OPACITY, _FIELD, _CLIP, _NOISE, _MODE = "opacity", "field", "clip", "noise", "compositing"

EFFECTS = (
    EffectScene("headlight", _LIGHT, _fixed(light=[HEADLIGHT])),
    EffectScene(_SHADED, _LIGHT, _lit()),
    EffectScene("point light", _LIGHT, _point_light),
    EffectScene("three lights", _LIGHT, _three_lights, _SHADED),
    EffectScene("one-sided", _LIGHT, _lit(material={"two_sided": False}), _SHADED),
    EffectScene("shading that fades", _LIGHT,
                lambda p: {"light": [LIGHT], "material": {"fade": 0.3 * p.slope}}, _SHADED),
    EffectScene("light, pre-integrated", _LIGHT,
                _lit(integration={"classification": "preintegrated"}), _SHADED),
    EffectScene("gradients precomputed", _LIGHT, _lit(gradient={"storage": "precomputed"}),
                _SHADED),
    EffectScene("gradients on the fly", _LIGHT, _lit(gradient={"storage": "on-the-fly"}), _SHADED),
    EffectScene("Sobel, precomputed", _LIGHT,
                _lit(gradient={"operator": "sobel", "storage": "precomputed"}), _SHADED),
    EffectScene("Sobel, on the fly", _LIGHT,
                _lit(gradient={"operator": "sobel", "storage": "on-the-fly"}), _SHADED),
    EffectScene("nearest", _FILTER, _fixed(integration={"filter": "nearest"})),
    EffectScene("cubic", _FILTER, _fixed(integration={"filter": "cubic"})),
    EffectScene("cubic, prefiltered", _FILTER,
                _fixed(integration={"filter": "cubic", "prefilter": True})),
    EffectScene("Catmull-Rom", _FILTER, _fixed(integration={"filter": "catmull-rom"})),
    EffectScene("Mitchell", _FILTER, _fixed(integration={"filter": "mitchell"})),
    EffectScene("cubic, lit", _FILTER, _lit(integration={"filter": "cubic"}), _SHADED),
    EffectScene("Catmull-Rom, lit", _FILTER, _lit(integration={"filter": "catmull-rom"}), _SHADED),
    EffectScene("opaque surface", _SURFACE, _surface),
    EffectScene("three surfaces", _SURFACE, _surfaces),
    EffectScene("refraction", _SURFACE, lambda p: _surface(p, opacity=0.3, refraction=1.3)),
    EffectScene("environment", _SKY, _environment("latlong")),
    EffectScene("environment, cube", _SKY, _environment("cube")),
    EffectScene("environment, visible", _SKY,
                _environment("latlong", visible=True, rotation_degrees=40.0), "environment"),
    EffectScene("shadow volume", _SHADOW, _shadow(method="volume"), _SHADED),
    EffectScene("shadow rays", _SHADOW, _shadow(method="rays"), _SHADED),
    EffectScene("scattering", _SHADOW, _shadow(**_SCATTER), "shadow volume"),
    EffectScene("ambient occlusion", _SHADOW,
                _fixed(ambient_occlusion={"directions": 16, "resolution": 24, "darkens": "all"})),
    EffectScene("gradient opacity", _OPACITY, _gradient_opacity),
    EffectScene("directional opacity", _OPACITY, _directional_opacity),
    EffectScene("two-value function", _OPACITY, _two_layers),
    EffectScene("label field", _FIELD, _label_field),
    EffectScene("density field", _FIELD, _density_field),
    EffectScene("mask field", _FIELD, _mask_field),
    EffectScene("clip plane", _CLIP, _clip_plane),
    EffectScene("clip box", _CLIP, _clip_box),
    EffectScene("clip sphere", _CLIP, _clip_sphere),
    EffectScene("noise on value", _NOISE, _noise("value")),
    EffectScene("noise, 4 octaves", _NOISE, _noise("value", 4)),
    EffectScene("noise on place", _NOISE, _noise("coordinate")),
    EffectScene("colour cycle", _NOISE, _fixed(animation={"time": 0.5, "cycle": 0.3})),
    EffectScene("depth cue", _NOISE, _fixed(depth_cue={"color": [0.1, 0.1, 0.2]})),
    EffectScene("maximum", _MODE, _fixed(integration={"compositing": "maximum"})),
    EffectScene("minimum", _MODE, _fixed(integration={"compositing": "minimum"})),
    EffectScene("average", _MODE, _fixed(integration={"compositing": "average"})),
    EffectScene("attenuated maximum", _MODE,
                _fixed(integration={"compositing": "attenuated-maximum", "attenuation": 2.0})),
)  # fmt: skip

_TOGETHER = (
    "three lights", "shading that fades", "scattering", "ambient occlusion", "three surfaces", "environment, visible",
    "gradient opacity", "directional opacity", "two-value function", "label field",
    "density field", "mask field", "clip plane", "clip box", "clip sphere", "noise, 4 octaves",
    "colour cycle", "depth cue",
)  # fmt: skip


def together(place: Place) -> Tables:
    """All that goes together: everything but the filters, storages and modes that exclude one
    another; the lights are those of "three lights", one of the surfaces refracts."""
    made: Tables = {}
    for name in _TOGETHER:
        tables = by_name(name).tables(place)
        if name != "three lights":
            tables = {key: table for key, table in tables.items() if key != "light"}
        made = with_tables(made, tables)
    first, *others = made["isosurface"]
    made["isosurface"] = [{**first, "refraction": 1.1}, *others]
    return made


def _clips_nothing(place: Place) -> Tables:
    beyond = 2.0 * place.edge
    lower, upper = (place.lower - beyond).tolist(), (place.upper + beyond).tolist()
    away = {"center": upper, "radius": 0.1 * place.edge, "keep": "outside"}
    return {"clip": [
        {"point": lower, "normal": [1.0, 1.0, 1.0]},
        {"type": "box", "lower": lower, "upper": upper},
        {"type": "sphere", **away},
    ]}  # fmt: skip


def _masks_nothing(place: Place) -> Tables:
    field = place.field(lambda x, y, z: np.ones_like(x), "float32")
    # A voxel beyond the volume on all sides, so that rounding at its faces masks nothing either.
    grid = field.grid
    wide = type(field)(
        np.ones([n + 2 for n in field.data.shape], np.float32), spacing=grid.spacing,
        origin=tuple(np.subtract(grid.origin, grid.spacing)),
    )  # fmt: skip
    return {"field": [{"file": wide, "role": "mask", "threshold": 0.5}]}


def _adds_nothing(place: Place) -> Tables:
    field = place.field(lambda x, y, z: x, "float32")
    points = [{"value": v, "opacity": 0.0, "color": [1.0, 0.0, 0.0]} for v in (0.0, 1.0)]
    return {"field": [{"file": field, "role": "density", "points": points}]}


def _labels_nothing(place: Place) -> Tables:
    field = place.field(lambda x, y, z: np.zeros_like(x), "uint8")
    listed = [{"label": 7, "color": [1.0, 0.0, 0.0], "opacity": 0.1}]
    return {"field": [{"file": field, "role": "label", "labels": listed}]}


def _hidden_surfaces(place: Place) -> Tables:
    return {"isosurface": [
        {"value": place.value(2.0)}, {"value": place.value(-1.0), "refraction": 1.5},
        {"value": place.value(0.5), "opacity": 0.0},
    ]}  # fmt: skip


def _ones(table: str, key: str) -> Callable[[Place], Tables]:
    return lambda place: {
        table: {"points": [{key: m * place.slope, "opacity": 1.0} for m in (0.0, 1.0)]}
    }


_STATED = "stated, without consequence"

# Each states an effect that changes nothing of a scene without lights.
UNUSED = (
    EffectScene("dead light", _STATED, _fixed(light=[{**LIGHT, "intensity": 0.0}])),
    EffectScene("black light", _STATED, _fixed(light=[{**HEADLIGHT, "color": [0.0, 0.0, 0.0]}])),
    EffectScene("shadow of a dead light", _STATED,
                _fixed(light=[{**LIGHT, "intensity": 0.0}], shadow={"method": "rays"})),
    EffectScene("material without light", _STATED,
                _fixed(material={"ambient": 0.4, "shininess": 7.0, "two_sided": False})),
    EffectScene("gradients without light", _STATED,
                _fixed(gradient={"operator": "sobel", "storage": "precomputed"})),
    EffectScene("surfaces not to be seen", _STATED, _hidden_surfaces),
    EffectScene("environment of intensity 0", _STATED, _environment("latlong", intensity=0.0)),
    EffectScene("gradient opacity of 1", _STATED, _ones("gradient_opacity", "magnitude")),
    EffectScene("directional opacity of 1", _STATED, _ones("directional_opacity", "derivative")),
    EffectScene("label that nothing has", _STATED, _labels_nothing),
    EffectScene("transparent density", _STATED, _adds_nothing),
    EffectScene("mask that keeps all", _STATED, _masks_nothing),
    EffectScene("clips that keep all", _STATED, _clips_nothing),
    EffectScene("noise of amplitude 0", _STATED,
                _fixed(noise=[{"target": "value", "amplitude": 0.0, "octaves": 8}])),
    EffectScene("depth cue of strength 0", _STATED,
                _fixed(depth_cue={"strength": 0.0, "color": [1.0, 0.0, 0.0]})),
    EffectScene("cycle of speed 0", _STATED, _fixed(animation={"time": 3.0, "cycle": 0.0})),
    EffectScene("attenuation without its mode", _STATED, _fixed(integration={"attenuation": 3.0})),
)  # fmt: skip


def all_unused(place: Place) -> Tables:
    """All of UNUSED in one scene."""
    made: Tables = {}
    for effect in UNUSED:
        made = with_tables(made, effect.tables(place))
    return made


def _sky_radiance(directions: np.ndarray) -> np.ndarray:
    """Linear RGB float32 [..., 3] from unit ``directions`` [..., 3]."""
    up = directions[..., 1:2]
    blue, ground = np.array([0.5, 0.7, 1.0]), np.array([0.15, 0.12, 0.1])
    sky = ground + (blue - ground) * np.clip(0.5 + 2.0 * up, 0.0, 1.0)
    sun = np.array([0.48, 0.6, 0.64])
    glow = np.clip(directions @ sun, 0.0, 1.0)[..., None] ** 64
    return (sky + 6.0 * glow * np.array([1.0, 0.9, 0.7])).astype(np.float32)


def _latlong_sky() -> np.ndarray:
    """float32 [h, 2 h, 3]: row 0 is +y, the middle column -z."""
    rows, columns = _SKY_ROWS, 2 * _SKY_ROWS
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    around = 2.0 * np.pi * ((np.arange(columns) + 0.5) / columns - 0.5)
    polar, around = np.meshgrid(polar, around, indexing="ij")
    flat = np.sin(polar)
    return _sky_radiance(
        np.stack([flat * np.sin(around), np.cos(polar), -flat * np.cos(around)], axis=-1)
    )


def _cube_sky() -> np.ndarray:
    """float32 [6 n, n, 3]: faces +x -x +y -y +z -z as OpenGL has them, row 0 on top."""
    n = _SKY_ROWS
    across = 2.0 * (np.arange(n) + 0.5) / n - 1.0
    v, u = np.meshgrid(-across, across, indexing="ij")  # u along the columns, v against the rows
    one = np.ones_like(u)
    faces = (
        (one, v, -u), (-one, v, u), (u, one, -v), (u, -one, v), (u, v, one), (-u, v, -one),
    )  # fmt: skip
    directions = np.concatenate([np.stack(face, axis=-1) for face in faces])
    return _sky_radiance(directions / np.linalg.norm(directions, axis=-1, keepdims=True))


def _write_exr(path: Path, rgb: np.ndarray) -> None:
    import OpenEXR

    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    temporary = path.with_suffix(".tmp.exr")
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(rgb)}).write(str(temporary))
    temporary.replace(path)
