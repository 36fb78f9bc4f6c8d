"""The gallery: every effect in a picture, together on one sheet (bench/gallery.png).

Measures nothing. Scenes are files of bench/gallery and data; one whose volume is not there is left
out, and said to be.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomllib

from bench.options import Options
from bench.report import machine, say, table

if TYPE_CHECKING:
    import numpy as np

SUMMARY = "a picture of every effect, on one sheet"
SCENES = Path(__file__).resolve().parent / "gallery"
DATA = Path(__file__).resolve().parent.parent / "data"
SHEET = Path(__file__).resolve().parent / "gallery.png"

TILE = (360, 300)  # pixels, width and height, on the sheet
COLUMNS = 4
_GAP, _MARGIN, _TEXT, _TITLE, _LINE = 14, 18, 13, 15, 17
_LINES = 2  # of a caption, below its title
_WRAP = 58  # characters a line
_BYTES = 1_200_000  # of the sheet: it is read on a page
_PAGE, _INK, _FAINT = (255, 255, 255), (28, 32, 38), (96, 104, 114)


@dataclass(frozen=True)
class Tile:
    """``scene``: a file's name without its ending, in SCENES or else in DATA. ``effect``: as
    ``clvol explain`` names it, called for in the scene. ``asked``: the tables that ask for it.
    ``more``: overrides (as ``load_scene`` takes them), for a second picture of one scene."""

    scene: str
    title: str
    caption: str
    effect: str
    asked: str
    more: tuple[str, ...] = ()

    @property
    def path(self) -> Path:
        inside = SCENES / f"{self.scene}.toml"
        return inside if inside.exists() else DATA / f"{self.scene}.toml"

    @property
    def name(self) -> str:
        """Unique: the scene's, and what is overridden."""
        return "-".join([self.scene, *(text.split("=")[1] for text in self.more)])

    def missing(self) -> list[Path]:
        """Files that the scene names and that are not there."""
        with open(self.path, "rb") as file:
            told = tomllib.load(file)
        tables = [told["volume"], *told.get("field", []), *told.get("channel", []), told.get("environment", {})]
        files = [self.path.parent / part["file"] for part in tables if "file" in part]
        return [file for file in files if not file.exists()]

    def load(self, width: int, height: int):
        """The Scene at ``width`` by ``height`` pixels."""
        from clvol import load_scene

        size = (f"image.width={width}", f"image.height={height}")
        return load_scene(self.path, (*self.more, *size))


TILES = (
    Tile("engine-lit", "Lit volume", "Three lights and their highlights, in translucent metal.",
         "specular", "[[light]], [material]"),
    Tile("engine-spots", "Spot lights and a slide", "Two spots, and a picture that is projected on an engine, with "
         "shadows.", "spot lights", '[[light]] type = "spot", "image"'),
    Tile("heptane-peaks", "Narrow peaks, pre-integrated and shaded",
         "Three shells, each a thirtieth of the range wide: none is missed.",
         "lighting", '[integration] classification = "preintegrated"'),
    Tile("heptane-peaks", "Light at both ends", "The same, each segment lit at both ends, weighed by where it shows.",
         "light at both ends", "[material] light_at", ('material.light_at="ends"',)),
    Tile("vismale-surfaces", "Iso-surfaces", "Skin and bone, their insides in other colours, in a "
         "translucent volume.", "isosurfaces", "[[isosurface]]"),
    Tile("teapot-glass", "Refraction", "Glass before a visible studio: rays bend where they cross "
         "the surface.", "refraction", "[[isosurface]] refraction"),
    Tile("teapot-mirage", "Continuous refraction", "An index of refraction that grows with the value: rays bend all "
         "along their way.", "continuous refraction", "[refraction]"),
    Tile("teapot-studio", "Environment light", "Irradiance and reflections of a studio's soft "
         "boxes, no other light.", "environment", "[environment]"),
    Tile("chest-shadows", "Shadows", "Rays to the light: ribs shade what lies below them.",
         "shadows", '[shadow] method = "rays"'),
    Tile("cthead-occlusion", "Ambient occlusion", "Sockets and teeth get less of the light from all around.",
         "ambient occlusion", "[ambient_occlusion]"),
    Tile("heptane-scattering", "Scattering", "Light scatters forward; the smoke's shade glows.",
         "scattering", "[shadow] scattering"),
    Tile("cloud", "Noise and sun", "An ellipsoid that noise stirs and frays, shadows and "
         "scattering in it.", "noise", "[[noise]]"),
    Tile("cloud-iridescent", "Noise of attenuation", "Scattered light whose attenuation differs by noise, a colour at "
         "a time: iridescence.", "attenuation noise", '[[noise]] target = "attenuation"'),
    Tile("ball-fur", "Fur", "Hairs that grow from a level along the gradient, each as long as noise says at its root.",
         "fur", '[[noise]] target = "fur"'),
    Tile("heptane-glow", "Associated colours", "Flames that emit without hiding anything, in smoke that emits "
         "nothing.", "associated colours", "[transfer_function] associated, emission"),
    Tile("fireball", "Fireball, 0 s", "A radial field, two noises that move, colours that cycle.",
         "colour cycling", "[[noise]] velocity, [animation] cycle"),
    Tile("fireball", "Fireball, 1.2 s", "The same scene later.",
         "colour cycling", "[animation] time", ("animation.time=1.2",)),
    Tile("tooth-layers", "Two-dimensional transfer function",
         "Of value and gradient magnitude: enamel, dentine and pulp apart.",
         "two-dimensional transfer function", "[[transfer_layer]]"),
    Tile("tooth-boundaries", "Generated function", "Made of the data: where value, gradient and second derivative tell "
         "that a boundary is.", "two-dimensional transfer function", '[transfer_function] generator'),
    Tile("cthead-gradient", "Gradient-weighted opacity", "What is even fades; boundaries stay.",
         "gradient opacity", "[gradient_opacity]"),
    Tile("inia19-labels", "Labels", "A second volume of anatomical labels colours half of a brain.",
         "label field", '[[field]] role = "label"'),
    Tile("inia19-mask", "Mask", "The same labels as a mask: a brain without its head.",
         "mask field", '[[field]] role = "mask"'),
    Tile("inia19-joint", "Joint transfer function",
         "Of the scan's value and a second volume's: one gives opacity, the other shifts the colour.",
         "joint transfer function", '[[field]] role = "value", [[transfer_layer]] values'),
    Tile("vismale-channels", "Channels", "Skin, muscle and bone as channels of colours of their own, whose light "
         "is screened.", "channels", "[[channel]], [integration] blend"),
    Tile("vismale-clipped", "Clipping", "By a box and a sphere; faces of the cut are lit.",
         "clipping", "[[clip]]"),
    Tile("cthead-star", "Clip by a mesh", "Exact to the facet: a star of triangles, read from a file.",
         "clipping", '[[clip]] type = "mesh"'),
    Tile("chest-blocks", "Lit, clipped blocks", "A ninth of the voxels' memory, spent on what the box leaves.",
         "clipping", '[integration] method = "multiresolution"'),
    Tile("aneurism-depth", "Depth cueing", "Far vessels fade into the page.",
         "depth cueing", "[depth_cue]"),
    Tile("aneurism-maximum", "Maximum intensity", "The greatest value on each ray.",
         "projection", '[integration] compositing = "maximum"'),
    Tile("aneurism-attenuated", "Attenuated maximum", "Near vessels pass before far ones.",
         "projection", '[integration] compositing = "attenuated-maximum"'),
    Tile("ellipsoid-linear", "Linear filter", "An ellipsoid of 10 by 7 by 9 voxels; cells show.",
         "isosurfaces", '[integration] filter = "linear"'),
    Tile("ellipsoid-catmull-rom", "Catmull-Rom filter", "The same voxels; the slope is continuous.",
         "catmull-rom filter", '[integration] filter = "catmull-rom"'),
    Tile("ellipsoid-mitchell", "Mitchell-Netravali filter", "A kernel between blurring and ringing.",
         "mitchell filter", '[integration] filter = "mitchell"'),
)  # fmt: skip


def run(options: Options) -> dict[str, Any] | None:
    """Renders every tile at twice its size on the sheet, or (quick) at a quarter."""
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    folder = options.folder / "gallery"
    folder.mkdir(parents=True, exist_ok=True)
    rows, left_out = [], []
    for tile in TILES:
        if options.scenes and tile.scene not in options.scenes:
            continue
        missing = tile.missing()
        if missing:
            left_out.append(tile.name)
            say(f"{tile.name}: left out, {missing[0].name} is not in {missing[0].parent.resolve()}")
            continue
        rows.append(_render(tile, device, folder, options.quick))
        say(f"{tile.name}: {rows[-1]['seconds']:.2f} s")
    if not rows:
        say("nothing to show")
        return None
    return {"machine": machine(device), "quick": options.quick, "rows": rows, "left_out": left_out}


def _render(tile: Tile, device: Any, folder: Path, quick: bool) -> dict[str, Any]:
    from PIL import Image

    from clvol import Renderer
    from clvol.image.png import display

    width, height = (n // 4 if quick else 2 * n for n in TILE)
    with Renderer(tile.load(width, height), devices=[device]) as renderer:
        frame = renderer.render()
    path = folder / f"{tile.name}.png"
    Image.fromarray(display(shrunk(frame.rgba, TILE), frame.background)).save(path)
    return {"name": tile.name, "picture": str(path), "seconds": frame.stats["seconds"]["render"]}


def shrunk(rgba: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """float32 [size[1], size[0], 4] from ``rgba`` [h, w, 4]: means in linear light. What is
    brighter than white is cut off first, so that edges of highlights stay smooth."""
    import numpy as np
    from PIL import Image

    shown = np.clip(rgba, 0.0, 1.0).astype(np.float32)
    channels = [Image.fromarray(np.ascontiguousarray(shown[..., i])) for i in range(4)]
    return np.stack([np.asarray(c.resize(size, Image.Resampling.BOX)) for c in channels], axis=-1)


def show(result: dict[str, Any]) -> str:
    rows = [[row["name"], f"{row['seconds']:.3f}"] for row in result["rows"]]
    return table(["scene", "s"], rows)


def draw(result: dict[str, Any], options: Options) -> list:
    partial = options.quick or options.scenes or result["left_out"]
    path = options.folder / "gallery.png" if partial else SHEET
    pictures = {row["name"]: row["picture"] for row in result["rows"]}
    compose([(tile, pictures[tile.name]) for tile in TILES if tile.name in pictures], path)
    return [path]


def compose(pictures: list[tuple[Tile, str]], path: Path) -> None:
    """The sheet: COLUMNS tiles a row, each with title and caption under it."""
    from PIL import Image, ImageDraw, ImageFont

    columns = min(COLUMNS, len(pictures))
    across, down = TILE[0] + _GAP, TILE[1] + _TITLE + 6 + _LINES * _LINE + _GAP + 4
    rows = -(-len(pictures) // columns)
    size = (2 * _MARGIN + columns * across - _GAP, 2 * _MARGIN + rows * down - _GAP)
    sheet = Image.new("RGB", size, _PAGE)
    pen = ImageDraw.Draw(sheet)
    title, text = ImageFont.load_default(_TITLE), ImageFont.load_default(_TEXT)
    for i, (tile, picture) in enumerate(pictures):
        x, y = _MARGIN + i % columns * across, _MARGIN + i // columns * down
        with Image.open(picture) as image:
            sheet.paste(image, (x, y))
        y += TILE[1] + 5
        pen.text((x, y), tile.title, _INK, title)
        for line in textwrap.wrap(tile.caption, _WRAP)[:_LINES]:
            y += _LINE
            pen.text((x, y + 2), line, _FAINT, text)
    save_small(sheet, path)


def save_small(sheet: Any, path: Path, most_bytes: int = _BYTES) -> None:
    """As PNG with as many bits per channel, from 8 down to 4, as take no more than ``most_bytes``."""
    import io

    for bits in (8, 7, 6, 5, 4):
        step = 255.0 / (2**bits - 1)
        levels = [round(round(value / step) * step) for value in range(256)]
        data = io.BytesIO()
        sheet.point(levels * 3).save(data, "PNG", optimize=True)
        if data.tell() <= most_bytes:
            break
    path.write_bytes(data.getvalue())
