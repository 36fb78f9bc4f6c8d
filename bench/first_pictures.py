"""First pictures: every shared volume as `clvol render VOLUME` shows it, on one sheet (bench/first-pictures.png).

Measures how long the choice takes, and the picture. A volume that is not there is left out.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from bench.gallery import save_small
from bench.options import Options
from bench.report import machine, say, table

SUMMARY = "every shared volume as it is shown unasked, on one sheet"
ROOT = Path(__file__).resolve().parent.parent
FOLDERS = (ROOT.parent / "shared" / "volumes", ROOT / "data")
SHEET = Path(__file__).resolve().parent / "first-pictures.png"
ENDINGS = (".nrrd", ".nii.gz", ".nii", ".mha", ".mhd", ".tif")

TILE, COLUMNS = 300, 5  # pixels of a picture on the sheet
_GAP, _TITLE, _TEXT, _LINE = 6, 14, 12, 16
_BYTES = 1_200_000
_INK, _FAINT, _PAGE = (230, 232, 236), (150, 156, 166), (24, 26, 30)


def volumes() -> list[Path]:
    """The volumes of FOLDERS, each name once, sorted by name."""
    found: dict[str, Path] = {}
    for folder in FOLDERS:
        for path in sorted(folder.glob("*")) if folder.is_dir() else []:
            if path.name.lower().endswith(ENDINGS):
                found.setdefault(path.name, path)
    return [found[name] for name in sorted(found)]


def run(options: Options) -> dict[str, Any] | None:
    """Renders each volume at twice its size on the sheet, or (quick) the smallest two at a quarter."""
    from clvol.opencl.devices import open_device

    device = open_device(options.device)
    folder = options.folder / "first-pictures"
    folder.mkdir(parents=True, exist_ok=True)
    paths = volumes()
    if options.quick:
        paths = sorted(sorted(paths, key=lambda path: path.stat().st_size)[:2])
    rows = []
    for path in paths:
        rows.append(_render(path, device, folder, TILE // 4 if options.quick else 2 * TILE))
        say(f"{path.name}: {rows[-1]['in_words']}")
    if not rows:
        say("nothing to show")
        return None
    return {"machine": machine(device), "quick": options.quick, "rows": rows}


def _render(path: Path, device: Any, folder: Path, pixels: int) -> dict[str, Any]:
    from clvol import Renderer, load_scene

    start = time.perf_counter()
    scene = load_scene(path, [f"image.width={pixels}", f"image.height={pixels}"])
    scene.load()
    loaded = time.perf_counter()
    scene = scene.completed()
    chosen = time.perf_counter()
    with Renderer(scene, devices=[device]) as renderer:
        frame = renderer.render()
    name = path.name.partition(".")[0]
    picture = folder / f"{name}.png"
    frame.save(picture)
    facts = scene.chosen or {}
    return {
        "name": name, "picture": str(picture), "kind": facts.get("kind", ""), "in_words": facts.get("in_words", ""),
        "voxels": scene.load_volume().nbytes // scene.load_volume().dtype.itemsize,
        "seconds": {
            "load": loaded - start, "choose": chosen - loaded, "render": frame.stats["seconds"]["render"],
        },
        "warnings": frame.stats.get("warnings", []),
    }  # fmt: skip


def show(result: dict[str, Any]) -> str:
    rows = [
        [row["name"], f"{row['voxels'] / 1e6:.1f}", row["kind"], f"{row['seconds']['choose']:.2f}",
         f"{row['seconds']['render']:.2f}"]
        for row in result["rows"]
    ]  # fmt: skip
    return table(["volume", "million voxels", "looks like", "choice, s", "picture, s"], rows)


def draw(result: dict[str, Any], options: Options) -> list:
    path = options.folder / "first-pictures.png" if options.quick else SHEET
    compose(result["rows"], path)
    return [path]


def compose(rows: list[dict[str, Any]], path: Path) -> None:
    """The sheet: COLUMNS pictures a row, each with its name and its kind under it."""
    from PIL import Image, ImageDraw, ImageFont

    columns = min(COLUMNS, len(rows))
    down = TILE + 2 * _LINE + _GAP
    size = (columns * (TILE + _GAP) + _GAP, -(-len(rows) // columns) * down + _GAP)
    sheet = Image.new("RGB", size, _PAGE)
    pen = ImageDraw.Draw(sheet)
    title, text = ImageFont.load_default(_TITLE), ImageFont.load_default(_TEXT)
    for i, row in enumerate(rows):
        x, y = _GAP + i % columns * (TILE + _GAP), _GAP + i // columns * down
        with Image.open(row["picture"]) as image:
            sheet.paste(image.convert("RGB").resize((TILE, TILE), Image.Resampling.BOX), (x, y))
        pen.text((x + 2, y + TILE + 1), row["name"], _INK, title)
        pen.text((x + 2, y + TILE + _LINE + 1), row["kind"], _FAINT, text)
    save_small(sheet, path, _BYTES)
