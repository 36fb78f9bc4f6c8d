"""Whether pictures take less time with starts from the picture before than without: measured, since it depends on the
scene, on the device and on how far the camera moves.

After two pictures with such starts some are rendered without. Where these took less, or nearly as little, many that
follow are, too: more of them each time that the next trial ends alike, or that starts were late, for then a picture is
rendered twice. No picture depends on it.
"""

from __future__ import annotations

_TRIED = 2  # pictures with starts, of which the quickest counts; others may have waited for the machine
_PLAIN = 4  # and without: it costs nothing to be sure that they do not take longer
_WORTH = 0.98  # of the time without: what starts must come below to be taken
_AGAIN = 128  # pictures with starts after which it is measured again
_PAUSE, _LONGEST_PAUSE = 128, 1024  # pictures without, at first and at most
LEAST_PIXELS = 1 << 16  # of pictures that are measured: smaller ones take a few milliseconds either way


class MeasuredGain:
    """Decides picture by picture. ``turn`` comes before a picture, ``took`` after it."""

    def __init__(self) -> None:
        self._pause = self._rests = 0  # pictures of the last pause, and what is left of it
        self._begin()

    def _begin(self) -> None:
        self._reused: list[float] = []  # seconds
        self._plain: list[float] = []
        self._gains = False  # as measured

    def turn(self) -> str | None:
        """Why the next picture is rendered without starts; None: it may take them."""
        if self._rests:
            self._rests -= 1
            return "nothing is gained"
        if self._gains and len(self._reused) < _AGAIN:
            return None
        if self._gains:
            self._begin()
        return None if len(self._reused) < _TRIED else "the gain is measured"

    def took(self, seconds: float, reused: bool) -> None:
        """What the picture took. ``reused``: with starts."""
        (self._reused if reused else self._plain).append(seconds)
        if self._gains or len(self._plain) < _PLAIN or len(self._reused) < _TRIED:
            return
        self._gains = min(self._reused) < _WORTH * min(self._plain[-_PLAIN:])
        if self._gains:
            self._pause = 0
        else:
            self.lost()

    def lost(self) -> None:
        """Pictures are rendered without starts for a while."""
        self._pause = self._rests = min(max(4 * self._pause, _PAUSE), _LONGEST_PAUSE)
        self._begin()
