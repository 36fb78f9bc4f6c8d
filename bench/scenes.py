"""The five scenes that clvol is measured on: real volumes and all kinds of transfer functions.

Volumes are placed with their spacing alone (no origin, no direction), so that a peer needs no more
than that to see the same world. Colours are linear light.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clvol.scene import Camera, Scene
    from clvol.volume import Volume

VOLUMES = Path(__file__).resolve().parent.parent.parent / "shared" / "volumes"
OPACITY_UNIT = 1.0
DATA = Path(__file__).resolve().parent.parent / "data"
FOV_DEGREES = 30.0
_TOWARDS_EYE = (0.6, 0.35, 0.72)

Point = tuple[float, float, tuple[float, float, float]]


@dataclass(frozen=True)
class BenchScene:
    """``points``: (value, opacity over OPACITY_UNIT, linear colour) of the transfer function.
    ``classification``: what suits it. Midpoints ("post") are the better rule where the function is
    smooth; what is narrower than a step needs "preintegrated".
    """

    name: str
    file: str
    summary: str
    points: tuple[Point, ...]
    classification: str = "post"

    def path(self, folder: Path = VOLUMES) -> Path:
        return folder / self.file

    def load(self, folder: Path = VOLUMES) -> Volume:
        """The volume at the world's origin, its axes along the world's."""
        from clvol import Volume, load_volume

        found = load_volume(self.path(folder))
        return Volume(found.data, spacing=found.grid.spacing, name=self.file)

    def scene(
        self, volume: Volume, size: int, tables: Mapping[str, Any] | None = None, **integration: Any
    ) -> Scene:
        """``size`` by ``size`` pixels of ``volume``; ``integration`` as in a scene file.
        ``tables``: more tables by name, over these (see ``effect_scenes.with_tables``)."""
        from bench.effect_scenes import with_tables
        from clvol import Scene

        settings = {
            "volume": volume,
            "camera": camera(volume),
            "image": {"width": size, "height": size},
            "transfer_function": {
                "opacity_unit": OPACITY_UNIT,
                "color_space": "linear",
                "points": [
                    {"value": float(value), "opacity": float(opacity), "color": list(color)}
                    for value, opacity, color in self.points
                ],
            },
            "integration": integration,
        }
        return Scene(**with_tables(settings, tables or {}))


def camera(volume: Volume) -> Camera:
    """A perspective view of the whole volume from a little to the right and above."""
    from clvol.scene import Camera

    grid = volume.grid
    centre = [(n - 1) * s / 2 for n, s in zip(grid.size, grid.spacing)]
    diagonal = math.sqrt(sum((n * s) ** 2 for n, s in zip(grid.size, grid.spacing)))
    distance = diagonal / 2 / math.sin(math.radians(FOV_DEGREES / 2))
    norm = math.hypot(*_TOWARDS_EYE)
    return Camera(
        position=tuple(c + distance * d / norm for c, d in zip(centre, _TOWARDS_EYE)),
        target=tuple(centre),
        up=(0.0, 1.0, 0.0),
        fov_degrees=FOV_DEGREES,
    )


def _peak(value: float, opacity: float, edge, top) -> tuple[Point, ...]:
    return (value - 6, 0.0, edge), (value, opacity, top), (value + 6, 0.0, edge)


SCENES = (
    BenchScene(
        "engine-smooth",
        "engine.nrrd",
        "semi-transparent, smooth",
        (
            (0, 0.0, (0.0, 0.0, 0.0)),
            (40, 0.0, (0.2, 0.2, 0.6)),
            (120, 0.02, (0.9, 0.5, 0.2)),
            (200, 0.05, (0.9, 0.8, 0.5)),
            (255, 0.2, (1.0, 1.0, 1.0)),
        ),
    ),
    BenchScene(
        "engine-peaks",
        "engine.nrrd",
        "three narrow peaks",
        (
            (0, 0.0, (1.0, 0.0, 0.0)),
            *_peak(76, 0.3, (1.0, 0.0, 0.0), (1.0, 0.2, 0.1)),
            *_peak(136, 0.3, (0.0, 1.0, 0.0), (0.2, 1.0, 0.2)),
            *_peak(196, 0.5, (0.2, 0.2, 1.0), (0.2, 0.3, 1.0)),
            (255, 0.0, (0.0, 0.0, 0.0)),
        ),
        classification="preintegrated",
    ),
    BenchScene(
        "aneurism",
        "aneurism.nrrd",
        "sparse",
        (
            (0, 0.0, (0.0, 0.0, 0.0)),
            (60, 0.0, (0.8, 0.2, 0.1)),
            (120, 0.3, (1.0, 0.4, 0.2)),
            (255, 0.8, (1.0, 0.9, 0.8)),
        ),
    ),
    BenchScene(
        "vismale",
        "vismale.nrrd",
        "nearly opaque",
        (
            (0, 0.0, (0.0, 0.0, 0.0)),
            (30, 0.0, (0.8, 0.5, 0.4)),
            (60, 0.5, (0.9, 0.6, 0.5)),
            (120, 0.8, (0.95, 0.9, 0.8)),
            (255, 0.95, (1.0, 1.0, 1.0)),
        ),
    ),
    BenchScene(
        "heptane",
        "heptane.nrrd",
        "translucent everywhere",
        (
            (0, 0.002, (0.1, 0.2, 0.8)),
            (80, 0.01, (0.1, 0.8, 0.3)),
            (160, 0.02, (0.9, 0.8, 0.2)),
            (255, 0.05, (1.0, 0.3, 0.1)),
        ),
    ),
)

# Only where time against error is looked at: 16 bits, 72 million voxels, anisotropic.
CHEST = BenchScene(
    "chest",
    "chest.nrrd",
    "large, 16 bits",
    (
        (0, 0.0, (0.0, 0.0, 0.0)),
        (1000, 0.0, (0.6, 0.2, 0.1)),
        (1080, 0.01, (0.8, 0.3, 0.2)),
        (1160, 0.02, (0.9, 0.45, 0.3)),
        (1250, 0.15, (1.0, 0.8, 0.6)),
        (1800, 0.5, (1.0, 0.95, 0.9)),
        (2979, 0.8, (1.0, 1.0, 1.0)),
    ),
)


def available(
    scenes: Iterable[BenchScene], names: Sequence[str], missing: list[str]
) -> Iterator[BenchScene]:
    """Those of ``scenes`` that were asked for by name (all, where none is named) and whose volume is
    there; the others that were asked for are said to be left out, and added to ``missing``."""
    from bench.report import say

    for scene in scenes:
        if names and scene.name not in names:
            continue
        if scene.path().is_file():
            yield scene
        else:
            say(f"{scene.name}: left out, there is no volume {scene.file} in ../shared/volumes")
            missing.append(scene.name)
