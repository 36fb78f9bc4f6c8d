"""A rendered picture, with its statistics and its provenance."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.features import called_for
from clvol.image import save_frame
from clvol.render.made_from import MadeFrom

if TYPE_CHECKING:
    from clvol.scene.resolve import ResolvedScene

STAGES = ("load", "prepare", "compile", "render", "write")


@dataclass(eq=False)
class Frame:
    """``rgba`` float32 [height, width, 4]: linear, premultiplied, without the background.

    ``depth`` float32 [height, width]: world distance along the ray from the eye (orthographic: from the
    camera plane) to where opacity reaches one half; infinite where it never does.
    ``background`` [3], linear. ``stats``: as ``--stats`` writes them. ``scene_source``: the scene as the
    text of a scene file. ``made_from``: a function that returns what the picture was made from
    (``clvol.render.made_from``).
    """

    rgba: np.ndarray
    depth: np.ndarray | None = None
    background: np.ndarray = field(default_factory=lambda: np.zeros(3))
    stats: dict[str, Any] = field(default_factory=dict)
    scene_source: str | None = None
    made_from: Callable[[], dict[str, Any]] | None = None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes .exr, .png or .npy, according to the ending; the file appears whole or not at all."""
        save_frame(self, path)


def make_frame(
    resolved: ResolvedScene,
    rgba: np.ndarray,
    depth: np.ndarray | None,
    seconds: dict[str, float],
    counted: dict[str, Any],
    devices: list[str],
    made_from: Callable[[], dict[str, Any]] | None = None,
) -> Frame:
    """A frame of ``resolved`` with stats: ``seconds`` by stage (a missing stage took no time) and
    everything else that was ``counted``. ``made_from``: its ``made_from``; determined now where it is None."""
    if made_from is None:
        made_from = MadeFrom(resolved)
        made_from()
    stages = {stage: seconds.get(stage, 0.0) for stage in STAGES}
    stats = {
        "seconds": {**stages, "total": sum(stages.values())},
        **{name: value for name, value in counted.items() if name != "seconds"},
        "devices": list(devices),
        "effects": called_for(resolved),
        "method": resolved.integration.method,
    }
    chosen = resolved.chosen_classification
    if chosen is not None and chosen.name == resolved.integration.classification:
        stats["classification"] = {"name": chosen.name, "reason": chosen.reason}
    if resolved.chosen is not None:
        stats["chosen"] = resolved.chosen
    return Frame(
        np.asarray(rgba, np.float32),
        None if depth is None else np.asarray(depth, np.float32),
        resolved.background,
        stats,
        resolved.source,
        made_from,
    )
