"""What a tree does beside what was demonstrated, and the tree that does nothing beside."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from learner.inference.goals import Subgoal
from learner.inference.targets import Target
from learner.model import Definition, Node


class Recovery(Protocol):
    """Nodes to be used around the steps of a task, each the use of a SubTree whose ID begins with `Recover_`.

    A Definition stands for the use of it. `definitions` are the further SubTrees that those given use.
    """

    @property
    def definitions(self) -> Sequence[Definition]: ...

    def first(self, subgoals: Sequence[Subgoal]) -> Sequence[Node]:
        """What is done before any of the subgoals is pursued."""

    def before(
        self, subgoal: Subgoal, done: Sequence[Target], instead: Sequence[Subgoal] = ()
    ) -> Node | Definition | None:
        """What makes room before a subgoal, unless it or one `instead` of it is done; targets in `done` hold."""

    def standing(self, subgoal: Subgoal) -> Sequence[Node]:
        """What moves a subgoal's reference away where it was put wrongly, before anything is built in its frame."""

    def otherwise(self, subgoal: Subgoal) -> Sequence[Node]:
        """What follows where a subgoal has failed."""


class NoRecovery:
    """A tree that does what was demonstrated and nothing else."""

    definitions: Sequence[Definition] = ()

    def first(self, subgoals: Sequence[Subgoal]) -> Sequence[Node]:
        return ()

    def before(self, subgoal: Subgoal, done: Sequence[Target], instead: Sequence[Subgoal] = ()) -> None:
        return None

    def standing(self, subgoal: Subgoal) -> Sequence[Node]:
        return ()

    def otherwise(self, subgoal: Subgoal) -> Sequence[Node]:
        return ()
