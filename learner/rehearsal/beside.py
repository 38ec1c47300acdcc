"""Work done beside: in a copy of this process, on another processor, while this one goes on."""

from __future__ import annotations

import os
import pickle
import signal
import threading
from collections.abc import Callable
from functools import cached_property
from typing import Final, Generic, TypeVar

from learner.progress import is_heard

Result = TypeVar("Result")
FAILED: Final = 1
"""What a copy exits with that has no result."""


class Beside(Generic[Result]):
    """Some work, begun at once where a processor can be had for it, else when its result is asked for.

    The copy starts from all that is known here and hands back a value that can be pickled. A process with several
    threads is not copied: what another of them holds would be held in the copy for good. Work that fails in the copy,
    or is killed there, is done again here, so that its error is raised here. Whoever begins it ends it.
    """

    def __init__(self, work: Callable[[], Result]) -> None:
        self._work = work
        self._copy = _Copy(work) if _may_copy() else None

    @cached_property
    def result(self) -> Result:
        """What came of the work. Raises what the work raises."""
        written = self._copy.written() if self._copy is not None else b""
        if not written:
            return self._work()
        found: Result = pickle.loads(written)
        return found

    def end(self) -> None:
        """End the copy, done or not."""
        if self._copy is not None:
            self._copy.end()


def _may_copy() -> bool:
    """Where the system tells which processors this process may use, it may use several, and no thread is in the way."""
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    return processors > 1 and threading.active_count() <= 1 + is_heard()


class _Copy:
    """A copy of this process that does some work, writes its result into a pipe, and is gone."""

    def __init__(self, work: Callable[[], object]) -> None:
        self._from, into = os.pipe()
        self._process = os.fork()
        if not self._process:
            _work_and_exit(work, into)
        os.close(into)

    def written(self) -> bytes:
        """The pickled result, once it is there; nothing if the work failed."""
        with open(self._from, "rb", closefd=False) as pipe:
            return pipe.read()

    def end(self) -> None:
        """End the copy, whatever it does, and let the system forget it."""
        os.close(self._from)
        os.kill(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)


def _work_and_exit(work: Callable[[], object], into: int) -> None:
    """Never returns: what the original has still to write or to close is the original's, as is what failed."""
    status = FAILED
    try:
        written = pickle.dumps(work())
        with open(into, "wb") as pipe:
            pipe.write(written)
        status = 0
    finally:
        os._exit(status)
