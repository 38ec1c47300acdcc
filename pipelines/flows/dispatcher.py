"""Who decides what is ingested and learned when: at once what it is told of, and in time whatever else is new.

    told of a file ──▶ ingest, in a warm process ──▶ what changed? ──▶ each task, in a warm process
    every period  ──▶ is anything new? ──┘                             a task never twice at once, any number of tasks

While nothing is new no flow runs, and Prefect's database does not grow. While no Prefect server answers, or one stops
to in the middle, the same is done without flows.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from pipelines.flows.jobs import ingest_files, learn_changed_task, warm_up
from pipelines.flows.log import LOG
from pipelines.flows.worker import Job, JobFailedError, JobGivenUpError, Worker
from pipelines.home import Home
from pipelines.service.prefect_server import START_S, is_ready
from pipelines.steps.changes import changed_tasks
from pipelines.steps.ingest import unsettled
from pipelines.steps.stores import open_lake
from storage.judged import FileState

PATIENCE_S: Final = (0.0, 10.0, 60.0, 600.0, 3600.0)
"""A task that could not be learned is tried again no sooner than so long after its first, second, … failure [s]."""
COMES_UP_S: Final = 1.5 * START_S
"""A server that is coming up is waited for so long [s], unless somebody knows better."""
GONE_S: Final = 15.0
"""A flow whose server has not answered for so long is given up [s]; Prefect itself would wait for hours."""


class Dispatcher:
    """Works from `run` to `stop`. Nothing that is being learned is waited for at the end: what was not published is
    learned again by the next one.
    """

    def __init__(self, home: Home, period_s: float, learners: int) -> None:
        self.home, self.period_s = home, period_s
        self._worker = Worker("ingest")
        self._learners = Learners(home, learners, self._changed)
        self._told: queue.SimpleQueue[Path | None] = queue.SimpleQueue()
        self._left: dict[Path, FileState | None] = {}
        self._begun, self._stop = threading.Event(), threading.Event()

    def warm_up(self) -> None:
        """Return once every process is ready. Raises JobFailedError."""
        self._learners.start()
        self._worker.do(warm_up)
        self._learners.wait_until_warm()

    def begin(self) -> None:
        """Wait no longer for a server that is coming up."""
        self._begun.set()

    def tell(self, file: Path) -> None:
        """A recording is finished."""
        self._told.put(file)

    def stop(self) -> None:
        """End `run`, and all processes."""
        self._stop.set()
        self._begun.set()
        self._told.put(None)

    def run(self) -> None:
        """Look at once, then work until `stop`."""
        self._await_server()
        look_s = time.monotonic()
        with self._worker, self._learners:
            while not self._stop.is_set():
                files = self._wait_for_files(look_s)
                self._pass(files)
                if not files:
                    look_s = time.monotonic() + self.period_s

    def _await_server(self) -> None:
        """A server that is just coming up shall show what is done at first."""
        until_s = time.monotonic() + COMES_UP_S
        while not (_served() or self._begun.wait(0.5)) and time.monotonic() < until_s:
            pass

    def _pass(self, files: list[Path]) -> None:
        try:
            self._ingest(files)
            self._learn_changed()
        except JobFailedError as error:
            LOG.error("ingest: %s", error)
        except Exception:  # noqa: BLE001  # one bad pass must not end the service; the next look tries again
            LOG.exception("a pass failed")

    def _wait_for_files(self, until_s: float) -> list[Path]:
        """The files that were told by now, or none once it is time to look."""
        files: list[Path] = []
        try:
            file = self._told.get(timeout=max(0.0, until_s - time.monotonic()))
            while True:
                files += [] if file is None else [file]
                file = self._told.get_nowait()
        except queue.Empty:
            return list(dict.fromkeys(files))

    def _ingest(self, files: list[Path]) -> None:
        if not files and self._unsettled() == self._left:
            return
        arguments = str(self.home.root), [str(file) for file in files]
        sentence = done(self._worker, ingest_files, *arguments, news=self._changed)
        LOG.info("ingest: %s", sentence)
        if not files:
            # What was looked at and is left, such as a lone part of a split demonstration, is no news.
            self._left = self._unsettled()

    def _unsettled(self) -> dict[Path, FileState | None]:
        return unsettled(self.home, open_lake(self.home))

    def _changed(self) -> None:
        """Something is in the lake, or a task came to an end, which may have changed meanwhile."""
        try:
            if not self._stop.is_set():
                self._learn_changed()
        except Exception:  # noqa: BLE001  # the lake does not answer, say; the next look tries again
            LOG.exception("it was not found out what changed")

    def _learn_changed(self) -> None:
        for task in changed_tasks(self.home, open_lake(self.home)):
            self._learners.learn(task)


class Learners:
    """Threads that learn one task each in a process of their own, from entering to leaving the context; `done` is
    called after each, and must not raise.
    """

    def __init__(self, home: Home, count: int, done: Callable[[], None]) -> None:
        self.home, self._done = home, done
        self._tasks: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._running: set[str] = set()
        self._failures: dict[str, tuple[int, float]] = {}
        self._warm = threading.Semaphore(0)
        self._threads = [threading.Thread(target=self._work, name=f"learner {n}", daemon=True) for n in range(count)]

    def __enter__(self) -> Learners:
        return self

    def __exit__(self, *_: object) -> None:
        for _thread in self._threads:
            self._tasks.put(None)

    def start(self) -> None:
        """Start the threads, which warm their processes up."""
        for thread in self._threads:
            thread.start()

    def wait_until_warm(self) -> None:
        """Return once every process has imported what learning needs."""
        for _ in self._threads:
            self._warm.acquire()

    def learn(self, task: str) -> None:
        """Learn a task as soon as a process is free, unless that is to be done already, or failed a short time ago."""
        with self._lock:
            count, last_s = self._failures.get(task, (0, 0.0))
            if task in self._running or time.monotonic() < last_s + PATIENCE_S[min(count, len(PATIENCE_S) - 1)]:
                return
            self._running.add(task)
        self._tasks.put(task)

    def _work(self) -> None:
        with Worker(threading.current_thread().name) as worker:
            try:
                worker.do(warm_up)
            except JobFailedError as error:
                # The first task will say so too, if it is not over by then.
                LOG.error("a learner did not warm up: %s", error)
            self._warm.release()
            while (task := self._tasks.get()) is not None:
                self._settle(task, self._learn(worker, task))

    def _learn(self, worker: Worker, task: str) -> bool:
        try:
            LOG.info("%s: %s", task, done(worker, learn_changed_task, str(self.home.root), task))
        except JobFailedError as error:
            LOG.error("%s was not learned: %s", task, error)
            return False
        return True

    def _settle(self, task: str, learned: bool) -> None:
        with self._lock:
            self._running.discard(task)
            count, _ = self._failures.pop(task, (0, 0.0))
            if not learned:
                self._failures[task] = count + 1, time.monotonic()
        if learned:
            self._done()


def done(worker: Worker, job: Job, *arguments: Any, news: Callable[[], None] = lambda: None) -> str:
    """What a job returns: in a flow while a server answers, else without; `news` as for the worker.

    Raises JobFailedError.
    """
    if _served():
        try:
            return worker.do(job, *arguments, True, hopeless=Absence(), news=news)
        except JobGivenUpError as error:
            LOG.warning("the Prefect server does not answer any more; %s is done again without a flow", error)
    return worker.do(job, *arguments, False)


class Absence:
    """Whether the server has not answered for a while, when called again and again."""

    def __init__(self) -> None:
        self._answered_s = time.monotonic()

    def __call__(self) -> bool:
        if _served():
            self._answered_s = time.monotonic()
        return time.monotonic() - self._answered_s > GONE_S


def _served() -> bool:
    return is_ready(os.environ["PREFECT_API_URL"], patience_s=GONE_S)
