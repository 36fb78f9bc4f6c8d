"""Channels: several values per voxel, as pictures that are blended or as one medium."""

from __future__ import annotations

from collections.abc import Sequence

from clvol.features.effect import Effect, counted, no, yes
from clvol.scene.resolve import ResolvedScene

NAME = "channels"
_BLENDED = {"additive": "added", "screen": "screened", "maximum": "compared for the brightest"}


def effect_of(scene: ResolvedScene) -> Effect:
    """The effect "channels" of a scene whose channels, if it has any, are one medium."""
    if scene.mixed_channels > 1:
        return yes(NAME, f"{scene.mixed_channels} channels are one medium, all but the first as density fields")
    return no(NAME, "the scene shows one value per voxel")


def effects_of(found: Sequence[Sequence[Effect]], scene: ResolvedScene) -> tuple[Effect, ...]:
    """Those of a scene of channels, from those of the scene of each: called for where one of them calls for it."""
    merged = [next((effect for effect in each if effect.called_for), each[0]) for each in zip(*found)]
    shown = sum(any(effect.called_for for effect in each) for each in found)
    how = _BLENDED[scene.integration.blend]
    is_used = yes(NAME, f"pictures of {counted(shown, 'channel')} are {how}")
    idle = no(NAME, "at most one channel shows anything")
    return tuple((is_used if shown > 1 else idle) if effect.name == NAME else effect for effect in merged)
