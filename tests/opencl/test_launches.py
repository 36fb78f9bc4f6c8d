"""Launches of one kernel by several queues do not meet PoCL's fault in counting who uses its code."""

from __future__ import annotations

import os
import random
import subprocess
import sys

import pytest

from clvol.opencl.devices import device_name
from clvol.opencl.launches import LaunchOrder

COMPLETE, RUNNING, QUEUED = 0, 1, 3


class _Launch:
    def __init__(self, driver: _Driver, queue: int, width: int) -> None:
        self._driver, self._status = driver, QUEUED
        self.queue, self.width = queue, width

    @property
    def command_execution_status(self) -> int:
        self._driver.step()  # whoever asks waits: time goes by
        return self._status

    def become(self, status: int) -> None:
        self._status = status

    @property
    def status(self) -> int:
        return self._status


class _Driver:
    """PoCL's cache of code (common.c, 3.1 to 5.0) for one kernel, and in-order queues whose launches begin and end in
    any order. ``early``: code is also found or made, and its use counted, when a launch is enqueued (3.1).
    ``faults``: ends that found no use of the code they gave back."""

    def __init__(self, seed: int, early: bool) -> None:
        self._random, self._early = random.Random(seed), early
        self._queues: dict[int, list[_Launch]] = {}
        self._codes: list[list[int]] = []  # [width, uses], the last one made or used first
        self.faults = 0
        self.together = 0  # most launches at once

    def enqueue(self, queue: int, width: int) -> _Launch:
        launch = _Launch(self, queue, width)
        if self._early:
            self._use_code(width)
        self._queues.setdefault(queue, []).append(launch)
        for _ in range(self._random.randrange(3)):
            self.step()
        return launch

    def step(self) -> None:
        waiting = [launches[0] for launches in self._queues.values() if launches]
        if not waiting:
            return
        launch = self._random.choice(waiting)
        if launch.status == QUEUED:
            self._begin(launch)
        else:
            self._end(launch)
        self.together = max(self.together, sum(each.status == RUNNING for each in waiting))

    def _begin(self, launch: _Launch) -> None:
        self._use_code(launch.width)
        launch.become(RUNNING)

    def _use_code(self, width: int) -> None:
        code = next((code for code in self._codes if width <= code[0]), None)
        if code is None:
            code = [width, 0]
        else:
            self._codes.remove(code)
        code[1] += 1
        self._codes.insert(0, code)

    def _end(self, launch: _Launch) -> None:
        first = self._codes[0]
        if first[1] == 0:
            self.faults += 1
        else:
            first[1] -= 1
        launch.become(COMPLETE)
        self._queues[launch.queue].pop(0)

    def finish(self) -> None:
        while any(self._queues.values()):
            self.step()


class _Queue:
    def __init__(self, number: int) -> None:
        self.number = number


def _run(seed: int, early: bool, order: LaunchOrder | None) -> _Driver:
    driver, choice = _Driver(seed, early), random.Random(seed)
    queues = [_Queue(number) for number in range(6)]
    for number in range(80):
        queue, width = choice.choice(queues), 8 * choice.randint(1, 1 + number)
        if order is None:
            driver.enqueue(queue.number, width)
        else:
            order.launch(queue, queue.number % 2, width, lambda q=queue, w=width: driver.enqueue(q.number, w))
    driver.finish()
    return driver


@pytest.mark.parametrize("early", [False, True])
def test_code_in_use_is_never_given_back(early):
    assert sum(_run(seed, early, None).faults > 0 for seed in range(100)) > 10  # the fault, where nothing is ordered
    runs = [_run(seed, early, LaunchOrder()) for seed in range(100)]
    assert [run.faults for run in runs] == [0] * 100
    assert max(run.together for run in runs) > 3  # launches that nothing endangers still run side by side


_QUEUES = """
import sys
import numpy as np
from clvol.opencl.arguments import value, writes
from clvol.opencl.context import DeviceContext
from clvol.opencl.devices import open_device

device = open_device(sys.argv[2])
contexts = [DeviceContext(device) for _ in range(3)]
launches = []
for context, width, rounds in zip(contexts, (8, 8, 4096), (80_000_000, 80_000_000, 1)):
    array = context.upload(np.zeros(width, np.float32), writable=True)
    declared = [writes("array", np.float32, "count"), value("count", np.int32), value("rounds", np.int32)]
    kernel = context.kernel(sys.argv[1], "work", declared)
    launches.append(kernel(context.queue, (width,), (8,), array=array, count=np.int32(width), rounds=np.int32(rounds)))
    context.queue.flush()
    if width == 8:
        while launches[-1].command_execution_status > 1:  # until it runs
            pass
for context in reversed(contexts):
    context.finish()
"""


def test_a_wide_launch_beside_narrow_ones(device, tmp_path):
    """Without an order, PoCL ends the process: the wide launch ends first, and its code is what the others return."""
    source = tmp_path / "work.cl"
    source.write_text("""kernel void work(global float *array, int count, int rounds)
    {
        const int i = get_global_id(0);
        float x = array[i];
        for (int n = 0; n < rounds; ++n) x = x * 1.0001f + 0.5f;
        if (i < count) array[i] = x;
    }
    """)
    command = [sys.executable, "-c", _QUEUES, str(source), device_name(device)]
    environment = {**os.environ, "POCL_AFFINITY": "0", "POCL_MAX_PTHREAD_COUNT": "4"}  # three at once
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
