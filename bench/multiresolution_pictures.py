"""Pictures of blocks: the sheet bench/multiresolution.png."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.gallery import save_small
from bench.multiresolution_scenes import BlockScene
from bench.options import Options

if TYPE_CHECKING:
    from clvol.store.geometry import BlockGrid
    from clvol.volume import Volume

# Of the levels, full resolution first; sRGB.
COLORS = ((228, 87, 46), (245, 190, 65), (120, 180, 70), (40, 170, 190), (105, 105, 215), (170, 90, 190))
_TILE, _GAP, _MARGIN, _TEXT, _LINE = 400, 10, 14, 13, 17
_PAGE, _INK, _FAINT = (255, 255, 255), (28, 32, 38), (96, 104, 114)
LARGEST_DIFFERENCE = 10.0  # CIEDE2000 where the scale ends


def level_sheet(
    scenes: Sequence[tuple[BlockScene, float]], options: Options, path: Path, size: int | None
) -> Path:
    """A row for each scene at its ratio of voxels' bytes to those allowed: all voxels; within the
    budget; the levels; the difference. ``size``: pixels that are rendered, by default twice those
    of the sheet."""
    rows = [_row(scene, ratio, options, size or 2 * _TILE) for scene, ratio in scenes]
    sheet, pen, text, places = sheet_of([row["pictures"] for row in rows], lines=2)
    x = _MARGIN + 2 * (_TILE + _GAP)
    for row, below in zip(rows, places):
        _legend(pen, text, x, below, row["legend"])
        pen.text((x, below + _LINE), f"nothing to be seen of: {row['dropped']}", _FAINT, text)
        _scale(sheet, pen, text, x + _TILE + _GAP, below)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_small(sheet, path)
    return path


def sheet_of(
    rows: Sequence[Sequence[tuple[np.ndarray, str]]], lines: int = 0, tile: int = _TILE
) -> tuple[Any, Any, Any, list[int]]:
    """Rows of pictures of ``tile`` pixels over their captions, with room for ``lines`` more below each row. Gives the
    sheet, its pen, its font, and where the first of these lines goes, row by row."""
    from PIL import Image, ImageDraw, ImageFont

    text = ImageFont.load_default(_TEXT)
    height, columns = tile + (2 + lines) * _LINE, max(map(len, rows))
    size = (2 * _MARGIN + columns * (tile + _GAP) - _GAP, 2 * _MARGIN + len(rows) * height)
    sheet = Image.new("RGB", size, _PAGE)
    pen = ImageDraw.Draw(sheet)
    tops = [_MARGIN + i * height for i in range(len(rows))]
    for row, y in zip(rows, tops):
        for k, (picture, caption) in enumerate(row):
            x = _MARGIN + k * (tile + _GAP)
            sheet.paste(Image.fromarray(picture).resize((tile, tile), Image.Resampling.BOX), (x, y))
            pen.text((x, y + tile + 4), caption, _INK, text)
    return sheet, pen, text, [y + tile + 4 + _LINE for y in tops]


def _row(scene: BlockScene, ratio: float, options: Options, size: int) -> dict[str, Any]:
    from clvol import Renderer
    from clvol.accuracy.metrics import delta_e
    from clvol.image.png import display

    devices = [options.device] if options.device else None
    volume = scene.scene.load()
    memory = int(volume.nbytes / ratio)
    with Renderer(scene.asked(volume, size, memory), devices) as renderer:
        frame = renderer.render(depth=False)
        residency = renderer._on_device.prepared.residency
        levels, grid = residency.blocks.levels, residency.source.blocks
    labelled = scene.plain(volume, size, level_tables(levels, grid, volume))
    with Renderer(scene.plain(volume, size), devices) as renderer:
        full = renderer.render(depth=False)
    with Renderer(labelled, devices) as renderer:
        colored = renderer.render(depth=False)
    apart = delta_e(frame.rgba, full.rgba)
    black = (0.0, 0.0, 0.0)
    told = frame.stats["blocks"]
    return {
        "pictures": [
            (display(full.rgba, black), f"{scene.scene.file}: all voxels, {volume.nbytes / 2**20:.1f} MiB"),
            (display(frame.rgba, black), f"as blocks within {memory / 2**20:.2f} MiB, {ratio:g} : 1"),
            (display(colored.rgba, black), "the blocks' resolutions, and how many have them"),
            (_heat(apart), f"difference, CIEDE2000: mean {apart.mean():.2f}, largest {apart.max():.1f}"),
        ],
        "legend": [
            (f"{grid.samples(level)}^3: {count}", COLORS[level])
            for level, count in enumerate(told["levels"])
        ],
        "dropped": told["dropped"],
    }  # fmt: skip


def level_tables(levels: np.ndarray, grid: BlockGrid, volume: Volume) -> dict[str, Any]:
    """Tables that colour a picture of ``volume`` by its blocks' ``levels``, lit from the eye."""
    labels = [
        {"label": level + 1, "color": [_linear(c) for c in COLORS[level]]}
        for level in range(grid.levels)
    ]
    field = {"file": level_volume(levels, grid, volume), "role": "label", "labels": labels}
    material = {"ambient": 0.35, "diffuse": 0.8, "specular": 0.0}
    return {"field": [field], "light": [{"type": "headlight"}], "material": material}


def level_volume(levels: np.ndarray, grid: BlockGrid, volume: Volume) -> Volume:
    """uint8, a voxel for every block where it is: its level + 1, or 0 where it is dropped. A layer
    more all around, since a field ends at the centres of its outermost voxels."""
    from clvol import Volume
    from clvol.store.source import DROPPED

    numbers = np.where(levels == DROPPED, 0, levels.astype(np.int64) + 1).astype(np.uint8)
    around = np.pad(numbers.reshape(grid.counts), 1, mode="edge")
    spacing = np.asarray(volume.grid.spacing) * grid.edge
    first = np.full(3, 0.5 * (grid.edge - 1) - grid.edge)  # in voxels, the added layer's centres
    axes = np.asarray(volume.grid.direction)
    origin = np.asarray(volume.grid.origin) + axes @ (first * np.asarray(volume.grid.spacing))
    return Volume(around, tuple(spacing), tuple(origin), axes)


def _linear(byte: int) -> float:
    from clvol.transfer.color import srgb_to_linear

    return float(srgb_to_linear(np.float64(byte / 255.0)))


def _heat(apart: np.ndarray) -> np.ndarray:
    from matplotlib import colormaps

    shown = colormaps["inferno"](np.clip(apart / LARGEST_DIFFERENCE, 0.0, 1.0))[..., :3]
    return np.rint(255 * shown).astype(np.uint8)


def _legend(pen: Any, text: Any, x: int, y: int, entries: list) -> None:
    for told, color in entries:
        pen.rectangle((x, y + 3, x + 10, y + 13), color)
        pen.text((x + 14, y), told, _FAINT, text)
        x += int(text.getlength(told)) + 20


def _scale(sheet: Any, pen: Any, text: Any, x: int, y: int) -> None:
    from PIL import Image

    bar = _heat(np.tile(np.linspace(0.0, LARGEST_DIFFERENCE, 200), (10, 1)))
    pen.text((x, y), "0", _FAINT, text)
    sheet.paste(Image.fromarray(bar), (x + 12, y + 4))
    pen.text((x + 216, y), f"{LARGEST_DIFFERENCE:g} and more", _FAINT, text)


def shrunk_picture(source: Path, path: Path, size: int = 640) -> Path:
    from PIL import Image

    with Image.open(source) as image:
        image.thumbnail((size, size), Image.Resampling.LANCZOS)
        image.save(path, optimize=True)
    return path
