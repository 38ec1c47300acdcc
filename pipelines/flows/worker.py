"""A process that has imported everything and does one job after another; another one where it died or was given up."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from multiprocessing import get_context, set_forkserver_preload
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, Final, Self

from pipelines.flows import log
from pipelines.flows.log import LOG

LOOK_S: Final = 2.0
"""How often it is asked whether a job is still worth waiting for [s]."""

Job = Callable[..., str]
"""A function of a module, for the process imports it; what it returns is a sentence."""


Answer = tuple[bool, str]
"""Whether a job was done, and a sentence."""


class JobFailedError(Exception):
    """A job raised, or its process died: a sentence. What was not published can be done again."""


class JobGivenUpError(Exception):
    """A job was ended because what it depends on was gone."""


def preload(modules: Sequence[str]) -> None:
    """Let each process have imported these modules; to be called before the first of them starts."""
    set_forkserver_preload(list(modules))


class Worker:
    """The process of one thread, from entering to leaving the context. It ends with ours: its pipe ends then.

    It is forked from a process that has imported what `preload` names and runs no code of ours, so that it is there at
    once, and what was imported is in memory once. A fork of our own process, with its threads, could hold their locks
    for ever.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._process: BaseProcess | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def do(
        self,
        job: Job,
        *arguments: Any,
        hopeless: Callable[[], bool] = lambda: False,
        news: Callable[[], None] = lambda: None,
    ) -> str:
        """What the job returns; `news`, which must not raise, is called each time that it tells news.

        Raises JobFailedError, and JobGivenUpError once `hopeless`, which is asked now and then, says so; either way the
        next job finds a process that works.
        """
        pipe = self._pipe_to_process()
        try:
            pipe.send((job, arguments))
            while (answer := self._answer(pipe, job, hopeless)) is None:
                news()
        except (EOFError, OSError):
            code = self._end()
            raise JobFailedError(f"its process ended with exit code {code} in the middle") from None
        done, sentence = answer
        if not done:
            raise JobFailedError(sentence)
        return sentence

    def _answer(self, pipe: Connection, job: Job, hopeless: Callable[[], bool]) -> Answer | None:
        """What the process says next: None for news, else what came of the job."""
        while not pipe.poll(LOOK_S):
            if hopeless():
                self._end()
                raise JobGivenUpError(f"{job.__name__} in {self.name}")
        answer: Answer | None = pipe.recv()
        return answer

    def _pipe_to_process(self) -> Connection:
        if self._process is None or not self._process.is_alive():
            self._end()
            context = get_context("forkserver")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_work, args=(theirs,), name=self.name, daemon=True)
            self._process.start()
            theirs.close()
        return self._pipe

    def _end(self) -> int | None:
        """End the process, whatever it does; its exit code."""
        if self._process is None:
            return None
        self._process.join(0.1)
        self._process.kill()
        self._process.join()
        self._pipe.close()
        code, self._process = self._process.exitcode, None
        return code


_OUR_END: list[Connection] = []
"""In the process: its end of the pipe. Empty elsewhere."""


def tell_news() -> None:
    """In a job: tell whoever waits for it that what others wait for is there. Nothing where no worker does the job."""
    for pipe in _OUR_END:
        pipe.send(None)


def _work(pipe: Connection) -> None:
    """In the process: do what is told until nobody is there to tell."""
    log.begin()
    _OUR_END.append(pipe)
    while True:
        try:
            job, arguments = pipe.recv()
        except EOFError:
            return
        pipe.send(_done(job, arguments))


def _done(job: Job, arguments: tuple[Any, ...]) -> Answer:
    """What came of it; a sentence, for an exception would not always survive the way back."""
    begun_s = time.monotonic()
    try:
        return True, job(*arguments)
    except Exception as error:  # noqa: BLE001  # told to whoever asked; where it arose is only known here
        LOG.exception("%s failed after %.1f s", job.__name__, time.monotonic() - begun_s)
        return False, f"{type(error).__name__}: {error}"
