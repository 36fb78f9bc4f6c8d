"""What the method "multiresolution" is measured on, after Ljung's pictures ("Adaptive sampling in single
pass, GPU-based raycasting of multiresolution volumes", Volume Graphics 2006): a CT angiography in place
of his "female", a CT scan in shells in place of his "crab"; and the bench's own scene of the chest.

The first two are pre-integrated, as scenes are by default and as long steps need it; the third is not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bench.effect_scenes import with_tables
from bench.scenes import CHEST, FOV_DEGREES, SCENES, BenchScene

if TYPE_CHECKING:
    from clvol.scene import Camera, Scene
    from clvol.volume import Volume


@dataclass(frozen=True)
class BlockScene:
    """``scene`` seen from the direction ``towards_eye``, ``up`` above, so that it fills ``fill`` of the
    picture: 1 leaves room for the volume's bounding sphere."""

    scene: BenchScene
    towards_eye: tuple[float, float, float]
    up: tuple[float, float, float]
    fill: float = 1.0

    @property
    def name(self) -> str:
        return self.scene.name

    def camera(self, volume: Volume) -> Camera:
        from clvol.scene import Camera

        grid = volume.grid
        centre = [(n - 1) * s / 2 for n, s in zip(grid.size, grid.spacing)]
        radius = math.dist((0, 0, 0), [n * s for n, s in zip(grid.size, grid.spacing)]) / 2
        distance = radius / math.sin(math.radians(FOV_DEGREES / 2)) / self.fill
        norm = math.hypot(*self.towards_eye)
        eye = tuple(c + distance * d / norm for c, d in zip(centre, self.towards_eye))
        return Camera(position=eye, target=tuple(centre), up=self.up, fov_degrees=FOV_DEGREES)

    def asked(
        self, volume: Volume, size: int, memory: int, tables: Mapping[str, Any] | None = None,
        **settings: Any,
    ) -> Scene:
        """``size`` by ``size`` pixels of ``volume`` in ``memory`` bytes; ``settings`` of the table
        [multiresolution]. ``tables``: more of them, over all of these."""
        own = {"camera": self.camera(volume), "multiresolution": {"memory": memory, **settings}}
        return self.scene.scene(
            volume, size, with_tables(own, tables or {}), method="multiresolution",
            classification=self.scene.classification,
        )  # fmt: skip

    def plain(self, volume: Volume, size: int, tables: Mapping[str, Any] | None = None) -> Scene:
        """The same by the plain ray caster, all voxels resident."""
        own = {"camera": self.camera(volume)}
        return self.scene.scene(volume, size, with_tables(own, tables or {}),
                                classification=self.scene.classification)  # fmt: skip


# Contrast-filled vessels and bones over faint soft tissue; values are HU + 1000.
FEMALE = BlockScene(
    BenchScene(
        "female",
        "chest.nrrd",
        "CT angiography: vessels and bones in faint tissue",
        (
            (0, 0.0, (0.0, 0.0, 0.0)),
            (1000, 0.0, (0.5, 0.15, 0.08)),
            (1060, 0.002, (0.6, 0.2, 0.1)),
            (1100, 0.004, (0.6, 0.1, 0.05)),
            (1160, 0.06, (0.55, 0.04, 0.02)),
            (1230, 0.15, (0.7, 0.12, 0.04)),
            (1330, 0.2, (0.75, 0.4, 0.18)),
            (1600, 0.35, (0.85, 0.7, 0.45)),
            (2979, 0.9, (1.0, 1.0, 0.95)),
        ),
        classification="preintegrated",
    ),
    towards_eye=(-0.3, -0.9, 0.2),
    up=(0.0, 0.0, 1.0),
    fill=1.45,
)
# A translucent shell around a hard one.
CRAB = BlockScene(
    BenchScene(
        "crab",
        "cthead.nrrd",
        "CT of a head: skin as a thin shell around bone",
        (
            (0, 0.0, (0.0, 0.0, 0.0)),
            (450, 0.0, (0.5, 0.25, 0.15)),
            (650, 0.02, (0.75, 0.4, 0.25)),
            (900, 0.0, (0.75, 0.4, 0.25)),
            (1200, 0.0, (0.35, 0.12, 0.05)),
            (1450, 0.1, (0.5, 0.25, 0.1)),
            (1900, 0.2, (0.8, 0.6, 0.35)),
            (3272, 0.9, (1.0, 1.0, 0.95)),
        ),
        classification="preintegrated",
    ),
    towards_eye=(0.75, -0.55, -0.3),
    up=(0.0, 0.0, -1.0),
    fill=1.5,
)
CHEST_BLOCKS = BlockScene(CHEST, FEMALE.towards_eye, FEMALE.up, FEMALE.fill)
BLOCK_SCENES = (FEMALE, CRAB, CHEST_BLOCKS)


def placed_as_in_bench(name: str) -> BlockScene:
    """One of ``scenes.SCENES``, seen as the rest of the bench sees it."""
    scene = next(scene for scene in SCENES if scene.name == name)
    return BlockScene(scene, (0.6, 0.35, 0.72), (0.0, 1.0, 0.0))
