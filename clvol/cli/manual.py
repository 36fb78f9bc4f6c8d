"""clvol --man: the manual page, made from the help of all commands; nothing in it is kept by hand."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import click

from clvol import __version__
from clvol.errors import ClvolError

# Of ``clvol.errors``, whose classes state the numbers, and of the signals.
_MORE_STATUSES = ((0, "Done."), (130, "Interrupted; 143 ended by SIGTERM, 129 by SIGHUP."))
_ENVIRONMENT = (
    ("CLVOL_DEBUG", "Set to 1: errors are followed by the Python traceback."),
    ("XDG_CACHE_HOME", "The folder clvol in it keeps compiled programs; by default ~/.cache."),
    ("POCL_CACHE_DIR", "The cache of the OpenCL runtime PoCL."),
)


def manual_page(group: click.Group) -> str:
    """The manual page of ``group`` and all its commands, in roff (man macros)."""
    context = click.Context(group, info_name="clvol")
    commands = [(name, group.get_command(context, name)) for name in group.list_commands(context)]
    lines = [
        f'.TH CLVOL 1 "" "clvol {_escaped(__version__)}" "User Commands"',
        ".SH NAME",
        f"clvol \\- {_escaped((group.help or '').strip().rstrip('.').lower())}",
        ".SH SYNOPSIS",
        ".B clvol",
        ".I COMMAND",
        "[OPTION]... [ARGUMENT]...",
        ".SH OPTIONS",
        *_options(group, context),
        ".SH COMMANDS",
    ]
    for name, command in commands:
        assert command is not None
        own = click.Context(command, info_name=name, parent=context)
        usage = " ".join(command.collect_usage_pieces(own))
        lines += [f'.SS "clvol {_escaped(name)} {_escaped(usage)}"', *_paragraphs(command.help or "")]
        lines += _options(command, own)
    lines += [".SH EXIT STATUS"]
    for status, meaning in sorted([*_MORE_STATUSES, *_statuses()]):
        lines += [".TP", f".B {status}", _escaped(meaning)]
    lines += [".SH ENVIRONMENT"]
    for name, meaning in _ENVIRONMENT:
        lines += [".TP", f".B {name}", _escaped(meaning)]
    lines += [".SH SEE ALSO", "clvol scene \\-\\-keys, which prints every key of a scene file."]
    return "\n".join(lines) + "\n"


def _statuses() -> list[tuple[int, str]]:
    """(exit status, what it means) from the classes of errors."""
    found: dict[int, list[str]] = {}
    for kind in ClvolError.__subclasses__():
        found.setdefault(kind.exit_status, []).append(" ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split()))
    return [(status, " ".join(texts)) for status, texts in found.items()]


def _options(command: click.Command, context: click.Context) -> Iterator[str]:
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None and record[1]:
            yield from (".TP", f".B {_escaped(record[0])}", _escaped(" ".join(record[1].split())))


def _paragraphs(text: str) -> Iterator[str]:
    """The paragraphs of a command's help; what click keeps as it is (\\b) is kept as it is."""
    for number, paragraph in enumerate(inspect.cleandoc(text.split("\f")[0]).split("\n\n")):
        if number:
            yield ".PP"
        if paragraph.startswith("\b"):
            yield from (".nf", *(_escaped(line) for line in paragraph.split("\n")[1:]), ".fi")
        else:
            yield _escaped(" ".join(paragraph.split()))


def _escaped(text: str) -> str:
    """``text`` as roff prints it: hyphens as they are typed, and no line that begins with a control character."""
    text = text.replace("\\", "\\e").replace("-", "\\-").replace('"', "\\(dq").replace("'", "\\(aq")
    text = "".join(c if c.isascii() else f"\\[u{ord(c):04X}]" for c in text)
    return f"\\&{text}" if text.startswith((".", "\\(aq")) else text
