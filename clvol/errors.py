"""Typed errors: what is wrong, where, and what was expected instead."""

from __future__ import annotations

from clvol.text import one_line


class ClvolError(Exception):
    """Base of every error that clvol raises on purpose.

    ``where`` names the place (a file, a scene key, an argument), ``what`` what was found there,
    ``expected`` what would have been right. ``str()`` is the one line that the command prints:
    ``WHERE: WHAT, expected EXPECTED``, with escapes in the place of control characters.
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
    """What can hardly be meant, though it is no error: the picture is what was asked for.

    ``where`` names the place (a scene key), ``what`` is found there and what follows from it, ``advice`` what to set. ``str()`` is
    the line that the command prints: ``WHERE: WHAT; ADVICE``.
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
    """The volume cannot be read, or is not what its header says, or does not fit."""

    exit_status = 2


class UsageError(ClvolError):
    """A command-line or call argument is wrong."""

    exit_status = 2


class DeviceError(ClvolError):
    """No OpenCL device works, or the one asked for does not."""

    exit_status = 3


class RenderError(ClvolError):
    """Rendering or writing the picture failed."""

    exit_status = 4
