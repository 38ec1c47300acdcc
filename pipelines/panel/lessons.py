"""After a demonstration was kept: it is taken in at once, and its task learned anew, while the person looks on."""

from __future__ import annotations

import math
import os
import queue
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Literal, Self

from learner.model import DemonstratedAction, Demonstration
from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.service.child import Child
from pipelines.steps.ingest import Ingested, ingest
from pipelines.steps.stores import open_lake

Stage = Literal["none", "reading", "refused", "learning", "learned", "failed"]
LOOK_S: Final = 0.1
LEARN_S: Final = 3600.0
"""Patience with a learner [s]."""


@dataclass(frozen=True)
class Understood:
    """One action as it was taken in: its `type` and `object`, and for a release the object that it rests nearest to,
    `near`, with the distance [m] of their origins.
    """

    type: str
    object: str
    near: str = ""
    distance_m: float = 0.0


@dataclass(frozen=True)
class Lesson:
    """What has come of the newest demonstration: `sentences` are doubts about it, or why it was refused; `published` is
    what `treewright learn --json` said.
    """

    stage: Stage = "none"
    task: str = ""
    understood: tuple[Understood, ...] = ()
    sentences: tuple[str, ...] = ()
    published: Mapping[str, Any] | None = None


class Lessons:
    """Takes demonstrations in, one after the other, from entering to leaving its context. `now` is the newest."""

    def __init__(self, home: Home) -> None:
        self._home = home
        self.now = Lesson()
        self._kept: queue.SimpleQueue[tuple[str, tuple[Path, ...]] | None] = queue.SimpleQueue()
        self._child: Child | None = None
        self._thread = threading.Thread(target=self._work, name="panel-lessons", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._kept.put(None)
        while self._thread.is_alive():
            if self._child is not None:
                self._child.end()
            self._thread.join(LOOK_S)

    def begin(self, demonstration_id: str, files: Sequence[Path]) -> None:
        """Take in a demonstration by its files, the parts of it; does not wait."""
        self.now = Lesson("reading")
        self._kept.put((demonstration_id, tuple(files)))

    def _work(self) -> None:
        while (kept := self._kept.get()) is not None:
            try:
                self.now = self._taken_in(*kept)
                # Who shows one demonstration after the other wants the tree of all of them.
                if self.now.stage == "learning" and self._kept.empty():
                    self.now = replace(self.now, stage="learned", published=self._learned(self.now.task))
            except Exception as error:  # noqa: BLE001  # it is told, and the next demonstration is taken in
                said = str(error) if CommandError.covers(error) else f"a defect: {type(error).__name__}: {error}"
                self.now = replace(self.now, stage="failed", sentences=(*self.now.sentences, said))

    def _taken_in(self, demonstration_id: str, files: tuple[Path, ...]) -> Lesson:
        """What became of a demonstration, also where somebody else has taken it in before."""
        lake = open_lake(self._home)
        result = ingest(self._home, lake, files)
        if result.quarantined:
            return Lesson("refused", sentences=tuple(each.reason for each in result.quarantined))
        shown = lake.entry(demonstration_id).demonstration
        understood = tuple(understood_of(action, shown) for action in shown.actions)
        told = Ingested.of(shown)
        return Lesson("learning", shown.task, understood, (*told.warnings, *told.doubts))

    def _learned(self, task: str) -> dict[str, Any]:
        """In a process of its own, so that the pages and Stop stay quick. Raises ChildFailedError with its sentence."""
        words = [sys.executable, "-m", "pipelines.cli", "learn", task, "--json"]
        environment = {**os.environ, "TREEWRIGHT_HOME": str(self._home.root)}
        with Child("learner", words, environment, self._home.logs / "learn.log", speaks_json=True) as child:
            self._child = child
            try:
                return child.hear(LEARN_S)
            finally:
                self._child = None


def understood_of(action: DemonstratedAction, demonstration: Demonstration) -> Understood:
    """An action in few words: what was taken, or what was released and what it rests nearest to."""
    rests = {name: math.hypot(*pose.position) for name, pose in (action.rest or {}).items()}
    rests.pop(demonstration.base_frame, None)
    if not rests:
        return Understood(action.type, action.object)
    near = min(rests, key=lambda name: rests[name])
    return Understood(action.type, action.object, near, rests[near])
