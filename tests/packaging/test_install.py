"""The wheel: complete, and able to render far from the checkout."""

from __future__ import annotations

import configparser
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from helpers.paths import ROOT


def run(*command: object, cwd: Path) -> str:
    """Standard output of a command that must succeed, away from the checkout's modules."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run([str(c) for c in command], cwd=cwd, env=environment,
                          capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy of the sources (no old build folder can lend it a file)."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in ("setup.cfg", "pyproject.toml", "LICENSE", "README.md"):
        if (ROOT / name).exists():
            shutil.copy(ROOT / name, source)
    for name in ("clvol", "cl", "data/presets"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation",
        "--no-index", "--wheel-dir", folder, source, cwd=folder)
    (built,) = folder.glob("clvol-*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new environment's folder of commands; it borrows the libraries of this one, not clvol."""
    folder = tmp_path_factory.mktemp("installed") / "environment"
    run(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder.parent)
    python = folder / "bin" / "python"
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))",
                    cwd=folder).strip())
    # Paths named in a .pth are searched, but their own .pth files (an editable clvol) are not read.
    libraries = dict.fromkeys((sysconfig.get_path("purelib"), sysconfig.get_path("platlib")))
    (site / "borrowed.pth").write_text("".join(f"{path}\n" for path in libraries))
    run(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps",
        "--no-index", wheel, cwd=folder)
    return folder / "bin"


def test_every_package_is_listed():
    """setup.cfg names the packages one by one; a new folder must not be forgotten."""
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    listed = config["options"]["packages"].split()
    folders = [path.parent.relative_to(ROOT) for path in ROOT.glob("clvol/**/__init__.py")]
    there = [".".join(folder.parts) for folder in folders]
    assert sorted(listed) == sorted([*there, "clvol.cl", "clvol.presets"])


def test_every_folder_with_modules_is_a_package():
    folders = {path.parent for path in (ROOT / "clvol").rglob("*.py")}
    assert [f.name for f in folders if not (f / "__init__.py").exists()] == []


def test_the_wheel_holds_every_module_and_kernel(wheel):
    expected = {str(p.relative_to(ROOT)) for p in (ROOT / "clvol").rglob("*.py")} | {"clvol/py.typed"}
    kernels = [p for p in (ROOT / "cl").rglob("*") if p.suffix in (".cl", ".h")]
    expected |= {f"clvol/{p.relative_to(ROOT)}" for p in kernels}
    expected |= {f"clvol/presets/{p.name}" for p in (ROOT / "data" / "presets").glob("*.toml")}
    held = set(zipfile.ZipFile(wheel).namelist())
    assert expected - held == set()
    strangers = [name for name in held if not name.startswith(("clvol/", "clvol-"))]
    assert strangers == []


def test_the_kernels_are_found_from_an_installed_wheel(installed, tmp_path):
    code = "from clvol.opencl.kernels_path import kernel_folder; print(kernel_folder())"
    folder = Path(run(installed / "python", "-c", code, cwd=tmp_path).strip())
    assert folder.is_relative_to(installed.parent.resolve())
    for kernel in (p for p in (ROOT / "cl").iterdir() if p.suffix in (".cl", ".h")):
        assert (folder / kernel.name).read_bytes() == kernel.read_bytes()


def test_the_kernels_are_found_from_the_checkout():
    from clvol.opencl.kernels_path import kernel_folder

    assert kernel_folder() == ROOT / "cl"


def test_the_version_is_the_package_s(installed, tmp_path):
    import clvol

    code = "from importlib.metadata import version; print(version('clvol'))"
    assert run(installed / "python", "-c", code, cwd=tmp_path).strip() == clvol.__version__


def test_an_installed_wheel_renders(installed, tmp_path, device):
    from clvol.image import load_image
    from clvol.opencl.devices import report_of

    run(installed / "clvol", "render", ROOT / "data" / "brainsmall.nrrd", "-o", tmp_path / "a.exr",
        "--set", "image.width=64", "--set", "image.height=64", "--device", report_of(device).name,
        cwd=tmp_path)
    image = load_image(tmp_path / "a.exr")
    assert image["rgba"].shape == (64, 64, 4) and image["rgba"][..., 3].max() > 0.0
