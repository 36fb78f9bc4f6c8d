"""What every test may ask for: each working OpenCL device in turn, and real volumes."""

from __future__ import annotations

import functools
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


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    for name in sorted({"device", "first_device"} & set(metafunc.fixturenames)):
        reports = _chosen(metafunc.config)
        reports = reports[:1] if name == "first_device" else reports
        if reports:
            parameters = [pytest.param(report, id=report.name) for report in reports]
        else:
            parameters = [pytest.param(None, id="none", marks=pytest.mark.skip(reason=_no_device))]
        metafunc.parametrize(name, parameters, indirect=True, scope="session")


@pytest.fixture(scope="session", autouse=True)
def _quick_compilers():
    """Intel's compiler takes ten times as long to optimise a program as all tests take to run it. The
    first device's programs are optimised: that both agree is a test of the code, not of compilers."""
    from clvol.opencl.context import DeviceContext

    DeviceContext.more_options = {"intel": ("-cl-opt-disable",)}
    yield
    DeviceContext.more_options = {}


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest):
    """A pyopencl.Device; the test runs once on each one that works."""
    from clvol.opencl.devices import open_device

    return open_device(request.param.name)


@pytest.fixture(scope="session")
def contexts():
    """One context a device, kept for the session so that nothing is compiled twice."""
    from clvol.opencl.context import DeviceContext

    made: dict = {}

    def context_of(device) -> DeviceContext:
        if device not in made:
            made[device] = DeviceContext(device)
        return made[device]

    return context_of


@pytest.fixture(scope="session")
def context(device, contexts):
    """The device's ``DeviceContext``."""
    return contexts(device)


@pytest.fixture(scope="session")
def first_device(request: pytest.FixtureRequest):
    """One pyopencl.Device, for what renders under dozens of settings: there it is the choice that is
    tested, and some compilers take ten seconds for each of the programs, which are tested elsewhere."""
    from clvol.opencl.devices import open_device

    return open_device(request.param.name)


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
