"""Work done beside gives what it gives here, whatever becomes of the copy that does it."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from learner.progress import heard_by
from learner.rehearsal import beside
from learner.rehearsal.beside import Beside


@contextmanager
def begun(work: Callable[[], object]) -> Iterator[Beside[object]]:
    """Some work, ended at the end."""
    begun = Beside(work)
    try:
        yield begun
    finally:
        begun.end()


@pytest.fixture
def copied(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever runs the tests may have threads, and one processor."""
    monkeypatch.setattr(beside, "_may_copy", lambda: True)


@pytest.mark.usefixtures("copied")
def test_work_is_done_in_another_process_that_knows_what_this_one_knows() -> None:
    known = list(range(100_000))  # more than a pipe holds
    with begun(lambda: (os.getpid(), known[::-1])) as work:
        process, found = work.result  # type: ignore[misc]  # what the work returns
    assert process != os.getpid()
    assert found == known[::-1]


@pytest.mark.usefixtures("copied")
def test_what_fails_beside_is_raised_here() -> None:
    with begun(lambda: 1 // 0) as work, pytest.raises(ZeroDivisionError):
        _ = work.result


@pytest.mark.usefixtures("copied")
def test_work_whose_copy_is_killed_is_done_here() -> None:
    here = os.getpid()

    def fragile() -> str:
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return "done"

    with begun(fragile) as work:
        assert work.result == "done"


@pytest.mark.usefixtures("copied")
def test_a_copy_that_is_ended_is_gone_whether_it_is_done_or_not() -> None:
    with begun(lambda: time.sleep(3600)) as work:
        assert work._copy is not None
        process = work._copy._process
    with pytest.raises(ChildProcessError):
        os.waitpid(process, 0)


def test_whoever_watches_a_terminal_is_served_as_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(threading, "active_count", lambda: 2)
    with heard_by(lambda doing: None), begun(os.getpid) as work:
        assert work.result != os.getpid()
    with begun(os.getpid) as work:
        assert work.result == os.getpid()


def test_a_process_with_threads_or_one_processor_does_its_work_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    try:
        with begun(os.getpid) as work:
            assert work.result == os.getpid()
    finally:
        over.set()
        thread.join()
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    with begun(os.getpid) as work:
        assert work.result == os.getpid()
