"""Typed errors: what is wrong, where, and what was expected instead."""

from __future__ import annotations

from clvol.text import one_line


class ClvolError(Exception):
    """The base class of every error that clvol raises on purpose.

    ``where`` names the place (a file, a scene key, an argument), ``what`` says what was found there, and
    ``expected`` what would have been right. ``str()`` is the one line that the command prints:
    ``WHERE: WHAT, expected EXPECTED``, in which control characters are escaped.
    ``exit_status`` is the command's exit status.
    """

    exit_status = 4

    def __init__(self, where: str, what: str, expected: str | None = None) -> None:
        self.where = str(where)
        self.what = str(what)
        self.expected = None if expected is None else str(expected)
        super().__init__(where, what, expected)

    def __str__(self) -> str:
        tail = f", expected {one_line(self.expected)}" if self.expected else ""
        return f"{one_line(self.where)}: {one_line(self.what)}{tail}".strip()


class ClvolWarning(UserWarning):
    """A warning about something that is valid but hardly intended; the picture is rendered as requested.

    ``where`` names the place (a scene key), ``what`` says what was found there and what follows from it, and
    ``advice`` what to set instead. ``str()`` is the line that the command prints: ``WHERE: WHAT; ADVICE``.
    """

    def __init__(self, where: str, what: str, advice: str | None = None) -> None:
        self.where, self.what = str(where), str(what)
        self.advice = None if advice is None else str(advice)
        super().__init__(where, what, advice)

    def __str__(self) -> str:
        tail = f"; {self.advice}" if self.advice else ""
        return " ".join(f"{self.where}: {self.what}{tail}".split())


class SceneError(ClvolError):
    """The scene is wrong: an unknown key, a wrong type, an impossible value."""

    exit_status = 2


class VolumeError(ClvolError):
    """The volume cannot be read, contradicts its header, or does not fit into memory."""

    exit_status = 2


class SeveralChannels(VolumeError):
    """A file has several channels, of which none is selected.

    ``numbers`` select them, ``names`` are theirs (None: without one). ``colors``: sRGB colours (three numbers from 0
    to 1), and ``ranges``: the values (lowest, highest) that the file states for displaying each; None where it states
    none.
    """

    def __init__(self, where: str, what: str, expected: str | None = None) -> None:
        super().__init__(where, what, expected)
        self.numbers: tuple[int, ...] = ()
        self.names: tuple[str | None, ...] = ()
        self.colors: tuple[tuple[float, float, float] | None, ...] = ()
        self.ranges: tuple[tuple[float, float] | None, ...] = ()


class UsageError(ClvolError):
    """A command-line or call argument is wrong."""

    exit_status = 2


class DeviceError(ClvolError):
    """No OpenCL device works, or the requested one does not."""

    exit_status = 3


class RenderError(ClvolError):
    """Rendering or writing the picture failed."""

    exit_status = 4


def error_of_status(status: int) -> type[ClvolError]:
    """The kind of error to raise for one of another process that ended with exit ``status``, of which no more is
    known. KeyError for a status that no error has."""
    return {each.exit_status: each for each in (RenderError, DeviceError, SceneError)}[status]
