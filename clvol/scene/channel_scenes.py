"""A scene with channels as one scene for each channel: their pictures are blended."""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakKeyDictionary

from clvol.scene.classification import with_classification
from clvol.scene.resolve import ResolvedScene

_known: WeakKeyDictionary[ResolvedScene, tuple[ResolvedScene, ...]] = WeakKeyDictionary()


def channel_scenes(resolved: ResolvedScene) -> tuple[ResolvedScene, ...]:
    """The scenes whose pictures are blended into that of ``resolved``, the first channel's first; ``resolved`` alone
    where there are no channels. Each has the volume and the function of its channel, and all else in common."""
    if not resolved.channels:
        return (resolved,)
    if resolved not in _known:
        _known[resolved] = tuple(
            with_classification(
                replace(
                    resolved, volume=channel.volume, transfer_function=channel.function, axis=channel.axis, channels=()
                )
            )
            for channel in resolved.channels
        )
    return _known[resolved]
