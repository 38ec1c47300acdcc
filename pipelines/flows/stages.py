"""The stages of learning as tasks of a flow: each has a run of its own, with a sentence in its log of what came out."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final, TypeVar
from uuid import UUID

from prefect import get_run_logger, task
from prefect.artifacts import create_progress_artifact, update_progress_artifact
from prefect.cache_policies import NO_CACHE

from learner.stages import Stages
from pipelines.flows.shown import artifact_key
from pipelines.steps.sentences import sentence_on

Result = TypeVar("Result")
SOON_S: Final = 2.0
"""What takes less long shows no progress, and what takes longer not more often [s]."""


class SeenStages(Stages):
    """Runs each stage of learning `task_name` as a task; `seconds` is how long each stage took in all [s]."""

    def __init__(self, task_name: str) -> None:
        self.task_name = task_name
        self.seconds: dict[str, float] = {}
        self._progress: UUID | None = None
        self._shown_s = 0.0

    def run(self, name: str, work: Callable[[], Result], **options: Any) -> Result:
        """Do the work in a task of this name; `options` are the task's."""
        return self._timed(name, lambda: task(name=name, cache_policy=NO_CACHE, **options)(_saying(work))())

    def progress(self, done: int, most: int) -> None:
        """As a progress artifact, where it takes long enough for a person to look."""
        now_s = time.monotonic()
        if now_s - self._shown_s < SOON_S:
            return
        self._shown_s = now_s
        share = 100.0 * done / most
        if self._progress is None:
            key, what = artifact_key("rehearsal", self.task_name), f"trees of {self.task_name} that were rehearsed"
            made = create_progress_artifact(share, key, what)
            assert isinstance(made, UUID)  # a coroutine only within an event loop
            self._progress = made
        else:
            update_progress_artifact(self._progress, progress=share)

    def end_progress(self) -> None:
        """The rehearsal is over, however few trees were needed."""
        if self._progress is not None:
            update_progress_artifact(self._progress, progress=100.0)

    def _timed(self, name: str, work: Callable[[], Result]) -> Result:
        begun_s = self._shown_s = time.monotonic()
        try:
            return work()
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - begun_s


def _saying(work: Callable[[], Result]) -> Callable[[], Result]:
    def stage() -> Result:
        result = work()
        get_run_logger().info(sentence_on(result))
        return result

    return stage
