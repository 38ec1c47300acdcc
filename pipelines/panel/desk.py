"""What all pages of a panel share: the cell that is watched, the data root, and what was chosen last."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from learner.model.scene import Scene
from pipelines.home import Home
from pipelines.panel.goals import Goal, destinations, goals_of
from pipelines.panel.lessons import Lessons
from pipelines.panel.lights import Light, lights_of
from pipelines.panel.run_watch import RunWatch
from pipelines.panel.sentences import Voice
from pipelines.panel.table import Destination
from pipelines.panel.watch import CellWatch, Frames, Sight
from storage.artifacts import ArtifactStore
from storage.errors import StorageError

if TYPE_CHECKING:
    import zenoh

LOOK_S: Final = 2.0
"""The store is asked for what is new at most this often [s], whoever looks."""


@dataclass
class Choice:
    """What the person at the panel chose last; a page that is opened anew begins with it."""

    task: str = ""
    user: str = ""


@contextmanager
def open_desk(
    session: zenoh.Session, home: Home, cell: str, frames: Frames, scene: Scene | None, network: Sequence[str]
) -> Iterator[Callable[[ArtifactStore], Desk]]:
    """What makes a desk of a store; it hears the cell while the block lasts. `network` are `treewright run`'s words."""
    with (
        CellWatch(session, cell, frames, scene) as watch,
        RunWatch(session, cell, [*network, "--store"], home) as runs,
        Lessons(home) as lessons,
    ):
        yield lambda store: Desk(watch, runs, lessons, store)


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
    _trouble: str = ""

    def rows(self) -> list[Mapping[str, Any]]:
        """The tasks of which a tree is stored, with their aliases.

        A store that fails keeps nobody from teaching, and Stop working: there are none then, and a light tells why.
        """
        try:
            rows = self.store.tasks()
        except StorageError as error:
            self._trouble = str(error)
            return []
        self._trouble = ""
        return list(rows)

    def tasks(self) -> list[str]:
        """The names of the tasks of which a tree is stored."""
        return [str(row["task"]) for row in self.rows()]

    def lights(self, sight: Sight, voice: Voice) -> tuple[Light, ...]:
        """The lights of a moment, with one for the store where it fails."""
        store = (Light(voice("store"), self._trouble, "red"),) if self._trouble else ()
        return (*store, *lights_of(sight, self.watch.frames, voice))

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
        except StorageError as error:
            self._trouble = str(error)
            return ()
