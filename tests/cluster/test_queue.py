"""The queue of tasks with a cluster that is played: who is left out, what is tried again, and what ends it."""

from __future__ import annotations

import json

import pytest

from clvol.cluster import queue as queue_module
from clvol.cluster.connection import Connection
from clvol.cluster.queue import TaskQueue
from clvol.errors import ClvolWarning, DeviceError, RenderError


class KilledWorker(Exception):
    pass


class Played:
    """A future that is over when it is made."""

    def __init__(self, status, value=None):
        self.status, self._value = status, value

    def result(self, timeout=None):
        return self._value

    exception = result

    def done(self):
        return True

    def cancel(self):
        self.status = "cancelled"

    def add_done_callback(self, call):
        if self.status != "pending":
            call(self)


class PlayedClient:
    """``play(number, try, worker)`` is what becomes of a task; ``checks`` the answers to checks by address."""

    def __init__(self, play, checks=None, resources=None):
        self.status, self._play, self.submitted = "running", play, []
        self.checks = {"a": "", "b": ""} if checks is None else checks
        self.resources = resources or {"opencl": 1}
        self.keys = set()

    class scheduler:
        @staticmethod
        def identity(n_workers):
            raise NotImplementedError

    def sync(self, call, n_workers, callback_timeout):
        assert call is self.scheduler.identity and n_workers == -1 and callback_timeout > 0
        return {"workers": {address: {"resources": self.resources} for address in self.checks}}

    def submit(self, function, request, *, key, workers, **how):
        assert key not in self.keys and how["resources"] == {"opencl": 1} and not how["pure"]
        self.keys.add(key)
        if "-check-" in key:
            answer = self.checks[workers[0]]
            return Played("error", answer) if isinstance(answer, Exception) else Played("finished", answer)
        number, attempt = map(int, key.split("-")[-2:])
        self.submitted.append((number, attempt, workers))
        assert "volume" not in request and json.loads(request)["folder"] == "/here"
        return self._play(number, attempt, workers)

    def cancel(self, futures, force):
        self.cancelled = len(futures)


def queue_of(client, wait=5.0) -> TaskQueue:
    return TaskQueue(Connection(client, "played", wait, []), lambda request: {}, "/here")


def done(number, *_):
    return Played("finished", {"it": number})


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(queue_module, "_LOOK", 0.01)
    monkeypatch.setattr(queue_module, "_PAUSE", 0.01)
    monkeypatch.setattr(queue_module, "_LOST", 0.1)


def test_each_task_is_answered_once():
    client = PlayedClient(done)
    answers = list(queue_of(client).run([{} for _ in range(9)]))
    assert sorted(each.number for each in answers) == list(range(9))
    assert all(each.said == {"it": each.number} and each.error is None for each in answers)
    assert [each[:2] for each in client.submitted] == [(number, 1) for number in range(9)]
    assert all(workers is None for *_, workers in client.submitted)


def test_what_others_are_making_is_asked_for_again():
    def play(number, attempt, workers):
        return Played("finished", {"busy": True} if number == 1 and attempt < 4 else {"it": number})

    answers = list(queue_of(PlayedClient(play)).run([{}] * 3))
    assert [each.number for each in answers] == [0, 2, 1]


def test_a_cancelled_task_is_handed_out_again():
    def play(number, attempt, workers):
        return Played("cancelled") if attempt == 1 else done(number)

    assert len(list(queue_of(PlayedClient(play)).run([{}] * 4))) == 4


def test_a_worker_that_does_not_fit_is_named_and_gets_nothing():
    client = PlayedClient(done, {"a": "", "b": "it has clvol 0.1, and the client 9"})
    with pytest.warns(ClvolWarning, match="worker b: is left out: it has clvol 0.1"):
        assert len(list(queue_of(client).run([{}] * 3))) == 3
    assert all(workers == ["a"] for *_, workers in client.submitted)


def test_a_worker_that_cannot_run_clvol_is_named():
    client = PlayedClient(done, {"a": "", "b": ModuleNotFoundError("No module named 'clvol'")})
    with pytest.warns(ClvolWarning, match="worker b: .* No module named 'clvol'"):
        list(queue_of(client).run([{}] * 3))


def test_a_worker_whose_files_differ_is_left_out_and_its_task_done_by_others():
    def play(number, attempt, workers):
        if workers is None and number == 0:
            return Played("finished", {"mismatch": "its v.npy has the digest 1", "worker": "b"})
        return done(number)

    client = PlayedClient(play)
    with pytest.warns(ClvolWarning, match="worker b: is left out: its v.npy"):
        answers = list(queue_of(client).run([{}] * 8))
    assert sorted(each.number for each in answers) == list(range(8))
    assert client.submitted[-1][2] == ["a"]


def test_no_worker_fits():
    client = PlayedClient(done, {"a": "reason one"})
    with pytest.warns(ClvolWarning), pytest.raises(RenderError, match="no worker fits .a: reason one."):
        list(queue_of(client).run([{}]))

    def play(number, attempt, workers):
        return Played("finished", {"mismatch": "no device", "worker": "a", "status": 3})

    with pytest.warns(ClvolWarning), pytest.raises(DeviceError, match="no device"):
        list(queue_of(PlayedClient(play, {"a": ""})).run([{}]))


def test_workers_need_the_resource():
    client = PlayedClient(done, resources={"gpu": 1})
    with pytest.warns(ClvolWarning), pytest.raises(RenderError, match="no resource opencl .dask worker --nthreads 1"):
        list(queue_of(client).run([{}]))


def test_no_worker_at_all_ends_after_the_wait():
    with pytest.raises(RenderError, match="no worker is there after 0 s"):
        list(queue_of(PlayedClient(done, {}), wait=0.1).run([{}]))


def test_a_task_whose_workers_die_is_tried_alone_and_then_given_up():
    client: PlayedClient

    def play(number, attempt, workers):
        return Played("error", KilledWorker()) if number == 2 else done(number)

    client = PlayedClient(play)
    answers = list(queue_of(client).run([{}] * 6))
    assert [each.number for each in answers if each.error is None] == [0, 1, 3, 4, 5]
    assert answers[-1].number == 2 and "died" in answers[-1].error and answers[-1].status == 4
    assert client.submitted[-1][:2] == (2, 2)


def test_a_task_that_was_only_near_a_death_is_done():
    def play(number, attempt, workers):
        return Played("error", KilledWorker()) if number in (2, 3) and attempt == 1 else done(number)

    answers = list(queue_of(PlayedClient(play)).run([{}] * 6))
    assert len(answers) == 6 and all(each.error is None for each in answers)


def test_an_unexpected_error_is_the_task_s():
    def play(number, attempt, workers):
        return Played("error", ZeroDivisionError("by\nzero")) if number == 1 else done(number)

    answers = {each.number: each for each in queue_of(PlayedClient(play)).run([{}] * 3)}
    assert answers[1].error.startswith("ZeroDivisionError: by") and "\n" not in answers[1].error
    assert answers[0].error is None and answers[2].error is None


def test_a_lost_scheduler_ends_the_run_and_keeps_what_is_done():
    def play(number, attempt, workers):
        if number < 2:
            return done(number)
        client.status = "connecting"
        return Played("cancelled")

    client = PlayedClient(play)
    answers = []
    with pytest.raises(RenderError, match="scheduler is lost; .* --resume goes on"):
        answers.extend(each.number for each in queue_of(client).run([{}] * 5))
    assert answers == [0, 1]


def test_tasks_do_not_run_far_ahead_of_one_that_is_late():
    def play(number, attempt, workers):
        return Played("finished", {"busy": True} if number == 0 and attempt < 6 else {"it": number})

    answers = [each.number for each in queue_of(PlayedClient(play)).run([{}] * 30, ahead=4)]
    assert answers[:4] == [1, 2, 3, 0] and sorted(answers) == list(range(30))


def test_tasks_for_workers_that_are_gone_go_to_others():
    def play(number, attempt, workers):
        if workers == ["a"] and number == 1:
            del client.checks["a"]
            client.checks["c"] = ""
            return Played("pending")
        return done(number)

    client = PlayedClient(play, {"a": "", "b": "it does not fit"}, {"opencl": 1.0})
    with pytest.warns(ClvolWarning):
        answers = list(queue_of(client).run([{}] * 4))
    assert sorted(each.number for each in answers) == [0, 1, 2, 3]
    assert client.submitted[-1][2] == ["c"]
