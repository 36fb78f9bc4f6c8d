"""Sources made whole say what the preprocessor would have made of them."""

from __future__ import annotations

import random
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from clvol.errors import RenderError
from clvol.opencl.arguments import writes
from clvol.opencl.kernels_path import kernel_folder
from clvol.opencl.source import whole_source

FILES = sorted(path.name for path in kernel_folder().glob("*.cl"))
# Switches whose values decide whether a text can be compiled at all.
FIXED = {"LANES": 16, "SAMPLE_BUFFERS": 1}


def switches() -> list[str]:
    """The names that the kernels' conditions ask for, but for those that the kernels themselves define."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in kernel_folder().iterdir())
    asked = {name for line in re.findall(r"^ *# *(?:if|elif)(.*)", text, re.MULTILINE)
             for name in re.findall(r"\b[A-Z][A-Z_0-9]+\b", line)}
    defined = set(re.findall(r"^ *# *define +([A-Z_0-9]+)", text, re.MULTILINE))
    return sorted(asked - defined - set(FIXED))


def preprocessed(path: Path, *options: str) -> tuple[str, int]:
    done = subprocess.run(["gcc", "-E", "-w", "-x", "c", *options, path], capture_output=True, encoding="utf-8")
    code = "".join(line for line in done.stdout.splitlines() if not line.startswith("#"))
    return re.sub(r"\s+", "", code), done.returncode


@pytest.mark.parametrize("file", FILES)
def test_a_whole_source_is_what_the_preprocessor_makes_of_the_files(tmp_path, file):
    if shutil.which("gcc") is None:
        pytest.skip("no C preprocessor (gcc) to compare with")
    folder = kernel_folder()
    whole = tmp_path / "whole.c"
    whole.write_text(whole_source(folder / file, [folder]), encoding="utf-8")
    assert not re.search(r'^ *# *include *"', whole.read_text(encoding="utf-8"), re.MULTILINE)
    rng = random.Random(file)
    for _ in range(3):
        chosen = {name: rng.choice([0, 1, 2]) for name in switches() if rng.random() < 0.7}
        defines = [f"-D{name}={value}" for name, value in {**chosen, **FIXED}.items()]
        expected = preprocessed(folder / file, *defines, "-I", str(folder))
        assert preprocessed(whole, *defines) == expected and len(expected[0]) > 100


def write(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        (folder / name.replace("_h", ".h").replace("_cl", ".cl")).write_text(text, encoding="utf-8")
    return folder / "main.cl"


GUARDED = "#ifndef {0}\n#define {0}\n{1}\n#endif\n"


@pytest.mark.parametrize("kind, files", {
    # What a condition includes is not there after it.
    "conditional first": {
        "main_cl": '#if A\n#include "x.h"\n#endif\n#include "x.h"\nint last;\n',
        "x_h": GUARDED.format("X", "int x;")},
    "either branch": {
        "main_cl": '#if A\n#include "x.h"\n#else\n#include "x.h"\nint other;\n#endif\n#include "x.h"\n',
        "x_h": GUARDED.format("X", "int x;")},
    "conditional inside": {
        "main_cl": '#include "y.h"\n#include "x.h"\n', "x_h": GUARDED.format("X", "int x;"),
        "y_h": GUARDED.format("Y", '#ifdef A\n#include "x.h"\nint a;\n#endif\nint y;')},
    "without a guard, twice": {"main_cl": '#include "x.h"\n#include "x.h"\n', "x_h": "f();\n"},
    "pragma once": {"main_cl": '#include "x.h"\n#if A\n#include "x.h"\n#endif\n',
                    "x_h": "#pragma once\nint x;\n"},
    "each includes the other": {
        "main_cl": '#include "x.h"\nint last;\n', "x_h": GUARDED.format("X", '#include "y.h"\nint x;'),
        "y_h": GUARDED.format("Y", '#include "x.h"\nint y;')},
    "comments and texts": {
        "main_cl": '/* #include "x.h"\n#include "x.h" */ int a; // "\n#include "x.h" /* why */\n'
                   'char *s = "/* no comment", q = \'"\'; // #endif\n#include "x.h"\n',
        "x_h": GUARDED.format("X", "int x; /* a\n* b */ int z;")},
    "else of a guard": {
        "main_cl": '#include "x.h"\n#include "x.h"\n', "x_h": "#ifndef X\n#define X\nint x;\n#else\nint y;\n#endif\n"},
    "something beside a guard": {
        "main_cl": '#include "x.h"\n#include "x.h"\n', "x_h": GUARDED.format("X", "int x;") + "f();\n"},
    "not there, not needed": {"main_cl": '#ifdef NEVER\n#include "nothing.h"\n#endif\nint a;\n'},
}.items())
def test_includes_of_every_kind(tmp_path, kind, files):
    if shutil.which("gcc") is None:
        pytest.skip("no C preprocessor (gcc) to compare with")
    main = write(tmp_path, **files)
    whole = tmp_path / "whole.c"
    whole.write_text(whole_source(main, []), encoding="utf-8")
    for options in ((), ("-DA=1",)):
        expected = preprocessed(main, *options)
        assert expected[1] == 0 and preprocessed(whole, *options) == expected


def test_a_text_is_not_repeated_where_it_is_there_for_certain(tmp_path):
    body = "int x;" * 100
    main = write(tmp_path, main_cl='#include "x.h"\n#if A\n#include "x.h"\n#endif\n#include "x.h"\n',
                 x_h=GUARDED.format("X", body))
    assert whole_source(main, []).count(body) == 1


def test_an_error_names_file_and_line(tmp_path):
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler (gcc) to make an error")
    main = write(tmp_path, main_cl='int a;\n#include "x.h"\nint b;\nwrong here;\n',
                 x_h=GUARDED.format("X", "/* two\nlines */\nbad there;"))
    whole = tmp_path / "whole.c"
    whole.write_text(whole_source(main, []), encoding="utf-8")
    done = subprocess.run(["gcc", "-fsyntax-only", whole], capture_output=True, encoding="utf-8")
    assert "x.h:5:" in done.stderr and "main.cl:4:" in done.stderr


def test_what_is_not_there_is_an_error_only_where_it_is_needed(tmp_path, context):
    source = '#if NEEDED\n#include "gone.h"\n#endif\nkernel void f(global int *a) { a[0] = 1; }\n'
    main = write(tmp_path, main_cl=source)
    context.kernel(str(main), "f", [writes("a", np.int32)], {"NEEDED": 0})
    with pytest.raises(RenderError, match="gone.h is not found"):
        context.kernel(str(main), "f", [writes("a", np.int32)], {"NEEDED": 1})


@pytest.mark.parametrize("files, what", [
    ({"main_cl": '#include "main.cl"\n'}, "includes itself"),
    ({"main_cl": '#include "x.h"\n', "x_h": '#include "main.cl"\n'}, "includes itself"),
    ({}, "cannot be read"),
])
def test_a_source_that_never_ends_or_is_not_there_is_refused(tmp_path, files, what):
    with pytest.raises(RenderError, match=what):
        whole_source(write(tmp_path, **files), [])


def test_text_that_is_not_utf_8_is_refused(tmp_path):
    (tmp_path / "main.cl").write_bytes(b"int a; /* \xff */")
    with pytest.raises(RenderError, match="UTF-8"):
        whole_source(tmp_path / "main.cl", [])
