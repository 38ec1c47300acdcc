"""What all pages of a panel share: the cell that is watched, the data root, and what was chosen last."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Final

from pipelines.panel.goals import Goal, destinations, goals_of
from pipelines.panel.lessons import Lessons
from pipelines.panel.run_watch import RunWatch
from pipelines.panel.table import Destination
from pipelines.panel.watch import CellWatch, Sight
from storage.artifacts import ArtifactStore
from storage.errors import StorageError

LOOK_S: Final = 2.0
"""The store is asked for what is new at most this often [s], whoever looks."""


@dataclass
class Choice:
    """What the person at the panel chose last; a page that is opened anew begins with it."""

    task: str = ""
    user: str = ""


@dataclass
class Desk:
    """One panel: its cell and the runs on it, what is learned of demonstrations, the artifact store, the choice."""

    watch: CellWatch
    runs: RunWatch
    lessons: Lessons
    store: ArtifactStore
    choice: Choice = field(default_factory=Choice)
    _goals: tuple[Goal, ...] = ()
    _goals_of: str = ""
    _looked_s: float = float("-inf")

    def tasks(self) -> list[str]:
        """The tasks of which a tree is stored."""
        return [str(row["task"]) for row in self.store.tasks()]

    def destinations(self, sight: Sight) -> tuple[Destination, ...]:
        """Where the newest tree of the chosen task brings things, as they stand now."""
        task, now_s = self.choice.task, time.monotonic()
        if task != self._goals_of or now_s - self._looked_s > LOOK_S:
            self._goals_of, self._looked_s = task, now_s
            self._goals = self._newest(task)
        return destinations(self._goals, sight.poses, self.watch.frames.base)

    def _newest(self, task: str) -> tuple[Goal, ...]:
        if task not in self.tasks():
            return ()
        try:
            newest = self.store.versions(task)[0]["version"]
            return goals_of(self.store.get(task, newest).tree)
        except StorageError:
            # The page of the versions tells what is wrong with them; here is only a picture that lacks its circles.
            return ()
