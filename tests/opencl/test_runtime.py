"""An OpenCL library that came with the environment is found without any variable being set."""

from __future__ import annotations

import os
from types import SimpleNamespace

import pytest

from clvol.opencl import icd, runtime


@pytest.fixture
def environment(tmp_path, monkeypatch):
    """A pretended environment with the library, and pyopencl's folder of .icd files."""
    (tmp_path / "lib").mkdir()
    library = tmp_path / "lib" / "libintelocl.so"
    library.write_bytes(b"")
    loader = tmp_path / "loader"
    loader.mkdir()
    python = SimpleNamespace(prefix=str(tmp_path), exec_prefix=str(tmp_path), path=[])
    monkeypatch.setattr(runtime, "sys", python)
    monkeypatch.setattr(runtime.site, "ENABLE_USER_SITE", False)
    monkeypatch.setattr(runtime, "loader_folder", lambda: loader)
    return library, loader


def test_registering_writes_the_library_s_path_once(environment):
    library, loader = environment
    assert runtime.register_runtimes() == [loader / "intel.icd"]
    assert (loader / "intel.icd").read_text() == f"{library}\n"
    os.utime(loader / "intel.icd", ns=(1, 1))
    assert runtime.register_runtimes() == [loader / "intel.icd"]
    assert (loader / "intel.icd").stat().st_mtime_ns == 1  # not written again
    assert [p.name for p in loader.iterdir()] == ["intel.icd"]


def test_a_moved_environment_is_registered_anew(environment):
    library, loader = environment
    (loader / "intel.icd").write_text("/somewhere/else/libintelocl.so\n")
    runtime.register_runtimes()
    assert (loader / "intel.icd").read_text() == f"{library}\n"


def test_nothing_to_register_writes_nothing(environment):
    library, loader = environment
    library.unlink()
    assert runtime.register_runtimes() == []
    assert list(loader.iterdir()) == []


def test_a_loader_without_a_folder_is_pointed_at_the_library(environment, tmp_path, monkeypatch):
    library, _ = environment
    for module in (runtime, icd):
        monkeypatch.setattr(module, "loader_folder", lambda: None)
    monkeypatch.setattr(icd, "_original_vendors", None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("OPENCL_VENDOR_PATH", str(tmp_path / "empty"))
    for name in ("OCL_ICD_VENDORS", "PYOPENCL_HOME"):
        monkeypatch.setenv(name, "x")  # so that monkeypatch puts both back afterwards
    assert runtime.register_runtimes() == []
    wanted, native = icd.platforms_wanted()
    assert not native and [found.library for found in wanted] == [str(library)]
    icd.point_loader_at(wanted)
    icds = icd.registered_icds(os.environ["OCL_ICD_VENDORS"])
    assert [found.library for found in icds] == [str(library)]
    icd.point_loader_at(None)
    assert "OCL_ICD_VENDORS" not in os.environ


def test_an_environment_that_cannot_be_written_is_used_all_the_same(environment, tmp_path, monkeypatch):
    """As root installs it for everybody, or in a container."""
    library, loader = environment
    monkeypatch.setattr(icd, "loader_folder", lambda: loader)
    monkeypatch.setattr(icd, "_original_vendors", None)
    monkeypatch.setenv("OPENCL_VENDOR_PATH", str(tmp_path / "empty"))

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(runtime.Path, "write_bytes", refuse)
    assert runtime.register_runtimes() == []
    wanted, native = icd.platforms_wanted()
    assert not native and [found.library for found in wanted] == [str(library)]
    assert list(loader.iterdir()) == []


def test_a_path_that_is_not_utf_8_is_registered(environment, tmp_path, monkeypatch):
    library, loader = environment
    odd = os.fsdecode(bytes(tmp_path) + b"/odd-\xff")
    os.makedirs(os.path.join(odd, "lib"))
    library.rename(os.path.join(odd, "lib", library.name))
    runtime.sys.prefix = runtime.sys.exec_prefix = odd
    assert runtime.register_runtimes() == [loader / "intel.icd"]
    assert (loader / "intel.icd").read_bytes() == os.fsencode(odd) + b"/lib/libintelocl.so\n"
    assert icd._icd(loader / "intel.icd")[0].library == os.path.join(odd, "lib", library.name)
