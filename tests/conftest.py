"""What every test may ask for: OpenCL devices, and real volumes; and which tests `make test` leaves out."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import gc
import mmap
import sys
from pathlib import Path

import pytest
from helpers.paths import VOLUMES

_no_device = ""  # why, when there is none


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--device", action="append", default=[], metavar="NAME",
                     help="run only on the device of this name (see `clvol doctor`); repeatable")


@functools.lru_cache(maxsize=1)
def _reports() -> tuple:
    """What the probe found; once a test session, and before any test calls OpenCL."""
    from clvol.opencl.devices import list_devices

    return tuple(list_devices())


def _chosen(config: pytest.Config) -> list:
    """The reports of the devices to test on."""
    global _no_device
    from clvol.errors import DeviceError
    from clvol.opencl.devices import select

    try:
        working = select(list(_reports()))
        wanted = config.getoption("--device")
        chosen = [select(list(_reports()), name)[0] for name in wanted] if wanted else working
    except DeviceError as error:
        _no_device = str(error)
        return []
    return list(dict.fromkeys(chosen))


_DEVICE_FIXTURES = {
    "device": slice(0, 1),  # the first device
    "other_device": slice(1, None),  # each one but the first
    "each_device": slice(None),
}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    for name in sorted(_DEVICE_FIXTURES.keys() & set(metafunc.fixturenames)):
        reports = _chosen(metafunc.config)
        if reports:
            reason = "only one OpenCL device works here, so there is none to compare it with"
        else:
            reason = _no_device
        reports = reports[_DEVICE_FIXTURES[name]]
        if reports:
            parameters = [pytest.param(report, id=report.name) for report in reports]
        else:
            parameters = [pytest.param(None, id="none", marks=pytest.mark.skip(reason=reason))]
        metafunc.parametrize(name, parameters, indirect=True, scope="session")


@pytest.hookimpl(tryfirst=True)  # before pytest deselects by marker
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks as `slow` what `make test` leaves out: see tests/README.md, "Tiers"."""
    seen: set[tuple[Path, str]] = set()
    for item in items:
        if not isinstance(item, pytest.Function) or not _uses_device(item):
            continue
        function = (item.path, getattr(item.cls, "__name__", "") + item.originalname)
        if function in seen and not item.get_closest_marker("every_case"):
            item.add_marker("slow")
            if _is_of_another_device(item) and _LONG_TO_COMPILE & set(item.path.parts):
                item.add_marker("exhaustive")
            if item.path.name in _EVERY_LOSS:
                item.add_marker("exhaustive")
        seen.add(function)


_LONG_TO_COMPILE = {"integrators", "render"}  # folders of tests that compile whole programs
_EVERY_LOSS = {"test_losses.py", "test_isolation_losses.py"}  # at every point, in every way: seconds each


def _is_of_another_device(item: pytest.Function) -> bool:
    """Whether this is the case of a test for a device that is not the first one."""
    first = _chosen(item.config)[:1]
    return hasattr(item, "callspec") and item.callspec.params.get("each_device", *first) not in first


def _uses_device(item: pytest.Function) -> bool:
    return bool({*_DEVICE_FIXTURES, "contexts"} & set(item.fixturenames))


def _opened(request: pytest.FixtureRequest):
    from clvol.opencl.devices import open_device

    return open_device(request.param.name)


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest):
    """The first pyopencl.Device that works (or of ``--device``): what most tests run on."""
    return _opened(request)


@pytest.fixture(scope="session")
def other_device(request: pytest.FixtureRequest):
    """A pyopencl.Device other than the first one, to be compared with it: one test for each."""
    return _opened(request)


@pytest.fixture(scope="session")
def each_device(request: pytest.FixtureRequest):
    """A pyopencl.Device; the test runs once on each one that works."""
    return _opened(request)


@pytest.fixture(scope="module")
def contexts():
    """``contexts(device)``: one ``DeviceContext`` per device, kept for the tests of a file, so that nothing is
    compiled twice, and released with its programs after them."""
    from clvol.opencl.context import DeviceContext

    made: dict = {}

    def context_of(device) -> DeviceContext:
        if device not in made:
            made[device] = DeviceContext(device)
        return made[device]

    yield context_of
    for context in made.values():
        context.release()


@pytest.fixture(scope="module")
def context(device, contexts):
    """The first device's ``DeviceContext``."""
    return contexts(device)


def _give_memory_back() -> None:
    """Returns to the system what compilers and released programs leave to the allocator: gigabytes in a long run."""
    gc.collect()
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):  # another C library than glibc
            ctypes.CDLL("libc.so.6").malloc_trim(0)


@pytest.fixture(scope="module", autouse=True)
def _memory_given_back():
    """After each file, once its contexts are released."""
    yield
    _give_memory_back()


_MOST_RESIDENT = 1200 * 2**20  # bytes, after which a test gives memory back by itself


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    """In files that compile hundreds of programs, also after a test."""
    with contextlib.suppress(OSError):  # a system without /proc
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        if pages * mmap.PAGESIZE > _MOST_RESIDENT:
            _give_memory_back()


@pytest.fixture(scope="session")
def shared_volume():
    """``shared_volume(name)``: the path of a real volume kept beside the repository, or a skip."""

    def find(name: str) -> Path:
        path = VOLUMES / name
        if not path.exists():
            pytest.skip(f"the volume {name} is not in ../shared/volumes")
        return path

    return find


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    workers = getattr(terminalreporter.config.option, "numprocesses", None)  # they ask, not we
    if not workers and not _reports.cache_info().currsize:
        return
    terminalreporter.section("OpenCL devices")
    used = {report.name for report in _chosen(terminalreporter.config)}
    for report in _reports():
        state = "left out by --device" if report.working else report.reason
        if report.name in used:
            state = "used"
        terminalreporter.write_line(f"{report.name}: {report.device or report.platform} "
                                    f"({report.driver or 'driver unknown'}): {state}")
    if _no_device:
        terminalreporter.write_line(_no_device)
