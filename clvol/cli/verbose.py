"""-v: logs decisions to stderr. Modules log to Python's logger "clvol", which has no handler without -v."""

from __future__ import annotations

import logging
import sys
from typing import TYPE_CHECKING

import click

from clvol.text import one_line

if TYPE_CHECKING:
    from clvol.scene import Scene

_log = logging.getLogger("clvol.scene")


class _Lines(logging.Handler):
    """Prints one line per record on the current stderr, with control characters as escapes."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            name = record.name.removeprefix("clvol.")
            text = f"clvol: {name}: {one_line(record.getMessage())}\n"
            encoding = getattr(sys.stderr, "encoding", None) or "utf-8"
            sys.stderr.write(text.encode(encoding, "backslashreplace").decode(encoding))
            sys.stderr.flush()
        except (OSError, ValueError, AttributeError):  # stderr is closed, or its reader has gone away
            pass


def _start(context: click.Context, parameter: click.Parameter, verbose: bool) -> None:
    """Sends the log to stderr until ``context`` ends; only once, even if -v is given several times."""
    logger = logging.getLogger("clvol")
    if not verbose or any(isinstance(handler, _Lines) for handler in logger.handlers):
        return
    handler, level = _Lines(), logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)

    def end() -> None:
        logger.removeHandler(handler)
        logger.setLevel(level)

    context.call_on_close(end)


def verbose_option() -> click.Option:
    """A new option -v, which is not passed to the command as an argument."""
    return click.Option(
        ["-v", "--verbose"], is_flag=True, is_eager=True, expose_value=False, callback=_start,
        help="Log decisions to standard error: device, method, effects, programs, settings that are tried.",
    )  # fmt: skip


def log_scene(scene: Scene, memory_cap: int | None) -> None:
    """Logs how ``scene`` is rendered and why, if logging is enabled."""
    if not _log.isEnabledFor(logging.INFO):
        return
    from clvol.features.analysis import effects
    from clvol.integrators.registry import integrator_of
    from clvol.scene.sizes import format_size

    resolved = scene.resolve(memory_cap)
    volume, how = resolved.volume, resolved.integration
    size = " x ".join(str(n) for n in volume.grid.size)
    _log.info("volume %s, %s, values %.6g to %.6g", size, volume.dtype, *volume.value_range)
    _log.info(
        "method %s, classification %s, filter %s, step %g (%s); about %s on the device",
        how.method, how.classification, how.filter, how.step, how.quadrature,
        format_size(integrator_of(resolved).device_bytes(volume, resolved)),
    )  # fmt: skip
    for effect in effects(resolved):
        if effect.called_for:
            _log.info("effect %s: %s", effect.name, effect.reason)
