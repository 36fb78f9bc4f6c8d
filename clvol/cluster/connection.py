"""The connection to a dask cluster: local workers of this command, or a cluster that exists already."""

from __future__ import annotations

import json
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from clvol.cluster.local import LocalWorkers
from clvol.cluster.quiet import silence
from clvol.errors import RenderError, UsageError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

DEATHS = 3  # of workers that had the same task, after which dask gives it up
CONNECT_SECONDS = 10.0
_WAIT = 60.0  # seconds for the first worker, where dask's configuration says nothing
_NO_WORKERS = "distributed.scheduler.no-workers-timeout"


@dataclass
class Connection:
    """``wait``: seconds after which it is an error that no worker is there. ``cores``: for each worker of this machine
    those that it uses; empty for a cluster of others."""

    client: Client
    name: str
    wait: float
    cores: list[list[int]]

    def worker_count(self) -> int:
        """The workers that are there now."""
        with suppress(Exception):  # a scheduler that is lost is reported elsewhere
            return len(self.client.scheduler_info(n_workers=-1)["workers"])
        return 0


@contextmanager
def connected(workers: int | None, scheduler: str | None) -> Iterator[Connection]:
    """Starts ``workers`` processes on this machine, which listen on the loopback address only, or joins the cluster of
    ``scheduler``: an address such as "tcp://host:8786" or "tls://host:8786", or a file that dask's scheduler has
    written. How TLS is used is stated by dask's own configuration ("distributed.comm.tls").

    UsageError if dask is not installed, RenderError if no scheduler answers.
    """
    check_installed("--scheduler" if workers is None else "--workers")
    if scheduler is None:
        with _local(workers or 1) as connection:
            yield connection
    else:
        with _joined(scheduler) as connection:
            yield connection


def check_installed(option: str) -> None:
    """UsageError if ``option`` needs a package that is missing."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        expected = "that package: pip install 'clvol[distributed]'"
        raise UsageError(option, "needs the package distributed (dask)", expected) from None


@contextmanager
def _local(count: int) -> Iterator[Connection]:
    import dask
    from distributed import Client, LocalCluster, Security

    silence()
    wait = float(dask.config.get(_NO_WORKERS) or _WAIT)
    settings = {"distributed.scheduler.allowed-failures": DEATHS - 1, _NO_WORKERS: wait}
    with ExitStack() as stack:
        try:
            with dask.config.set(settings), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the port of a dashboard that nobody asks for may be taken
                cluster = LocalCluster(
                    n_workers=0, host="127.0.0.1", protocol="tcp", dashboard_address=None,
                    silence_logs=logging.CRITICAL, security=Security(require_encryption=False),
                )  # fmt: skip
        except (OSError, RuntimeError, TimeoutError) as error:
            raise RenderError("--workers", f"their scheduler cannot be started: {error}") from None
        scratch = stack.enter_context(TemporaryDirectory(prefix="clvol-", ignore_cleanup_errors=True))
        workers = LocalWorkers(cluster.scheduler_address, count, scratch)
        stack.callback(workers.close)
        stack.callback(_close_cluster, cluster)
        client = Client(cluster)
        stack.callback(_close, client)
        stack.callback(workers.stop_replacing)
        workers.wait_for_one(wait)
        yield Connection(client, "local workers", wait, shares(count))


def _close_cluster(cluster: LocalCluster) -> None:
    with suppress(Exception):
        cluster.close(timeout=5)


def shares(count: int) -> list[list[int]]:
    """The cores of this process divided among ``count`` workers."""
    known = hasattr(os, "sched_getaffinity")
    cores = sorted(os.sched_getaffinity(0)) if known else list(range(os.cpu_count() or 1))
    return [cores[k::count] or [cores[k % len(cores)]] for k in range(count)]


@contextmanager
def _joined(scheduler: str) -> Iterator[Connection]:
    import dask
    from distributed import Client

    silence()
    address = _address_in(scheduler) if Path(scheduler).is_file() else scheduler
    if ":" not in address:
        expected = "an address such as tcp://host:8786, or a file that 'dask scheduler --scheduler-file' has written"
        raise UsageError("--scheduler", f"there is no file {scheduler!r}", expected)
    try:
        client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
        expected = "the address of a dask scheduler that runs, or its file"
        raise RenderError("--scheduler", f"{scheduler} does not answer: {error}", expected) from None
    try:
        yield Connection(client, scheduler, float(dask.config.get(_NO_WORKERS) or _WAIT), [])
    finally:
        _close(client)


def _address_in(file: str) -> str:
    """The address in a file that a scheduler has written."""
    try:
        text = Path(file).read_text(encoding="utf-8")
        return str(json.loads(text)["address"])
    except (OSError, ValueError, KeyError, TypeError):
        expected = "one that 'dask scheduler --scheduler-file' has written"
        raise UsageError("--scheduler", f"{file} is not the file of a scheduler", expected) from None


def _close(client: Client) -> None:
    with suppress(Exception):  # its scheduler may be lost
        client.close(timeout=2)
