"""Clip planes, boxes, spheres and meshes."""

from __future__ import annotations

from clvol.features.effect import joined, no, yes
from clvol.features.findings import NOTHING_VISIBLE, Findings
from clvol.features.geometry import cuts
from clvol.scene.clip import Clip

_NOUNS = {"plane": "clip plane", "box": "clip box", "sphere": "clip sphere", "mesh": "clip mesh"}


def analyse(found: Findings) -> None:
    clips, name = found.scene.clips, "clipping"
    if not clips:
        found.note(no(name, "the scene has no clip"))
        return
    grid = found.scene.volume.grid
    kept = () if found.blank else tuple(dict.fromkeys(c for c in clips if cuts(c, grid)))
    if len(kept) == 1:
        found.note(yes(name, f"the {_NOUNS[kept[0].type]} cuts into the volume"))
    elif kept:
        found.note(yes(name, f"{len(kept)} clips cut into the volume"))
    elif found.blank:
        found.note(no(name, NOTHING_VISIBLE))
    else:
        found.note(no(name, joined(_reason(clip) for clip in clips)))
    found.change(clips=kept)


def _reason(clip: Clip) -> str:
    noun = _NOUNS[clip.type]
    if clip.type == "plane" or clip.keep == "outside":
        return f"the {noun} does not meet the volume"
    return f"the {noun} holds the whole volume"
