"""Pictures of the method "pyramid" beside the plain ray caster's: the sheet bench/pyramid.png."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.gallery import save_small
from bench.multiresolution_pictures import sheet_of
from bench.multiresolution_scenes import BlockScene
from bench.options import Options
from bench.pyramid_scenes import by_pyramid, by_rays

TIMES = 20  # that differences are shown


def difference_sheet(
    scenes: Sequence[tuple[BlockScene, dict[str, Any]]], options: Options, path: Path
) -> Path:
    """A row for each scene, as measured in ``parts.paper``: by the plain ray caster, by the method
    "pyramid", and the difference."""
    sheet, *_ = sheet_of([_row(scene, row, options) for scene, row in scenes])
    path.parent.mkdir(parents=True, exist_ok=True)
    save_small(sheet, path)
    return path


def _row(
    scene: BlockScene, row: dict[str, Any], options: Options
) -> list[tuple[np.ndarray, str]]:
    from clvol import Renderer
    from clvol.accuracy.metrics import rmse
    from clvol.image.png import display

    volume, step = scene.scene.load(), {"step": row["step"]}
    asked = {
        "plain": by_rays(scene, volume, row["size"], **step),
        row["best"]: by_pyramid(scene, volume, row["size"], step, **row["settings"][row["best"]]),
    }
    pictures = {}
    for way, resolved in asked.items():
        with Renderer(resolved, [options.device] if options.device else None) as renderer:
            pictures[way] = renderer.render(depth=False).rgba
    plain, adaptive = pictures.values()
    names = {"plain": f"{scene.name}, plain ray caster", row["best"]: f"pyramid, {row['best']}"}
    apart = f"difference times {TIMES}, RMSE {rmse(plain, adaptive):.1e}"
    return [
        *((display(pictures[way], (0.0, 0.0, 0.0)), f"{name}: {_told(row['ways'][way])}")
          for way, name in names.items()),
        (difference(plain, adaptive), apart),
    ]  # fmt: skip


def _told(way: dict[str, Any]) -> str:
    return f"{way['samples'] / 1e6:.2f} million samples, {1e3 * way['time']['median']:.3g} ms"


def difference(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """uint8 [h, w, 3]: how far apart both are as displayed over black, channel by channel, TIMES so
    much."""
    from clvol.transfer.color import linear_to_srgb

    a, b = (linear_to_srgb(np.clip(rgba[..., :3], 0.0, 1.0)) for rgba in (one, other))
    return np.rint(255 * np.clip(TIMES * np.abs(a - b), 0.0, 1.0)).astype(np.uint8)
