"""Recovery from what was not demonstrated: what covers an object or occupies its place is put aside first.

All of it stands in SubTrees whose ID begins with `Recover_`. With a scene every object that can be grasped may cover
or occupy; without one, objects are points and only the stackings that were demonstrated are known. Fallbacks over an
action have memory, so that lifting an object off does not end the action that lifts it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from learner.inference.goals import Subgoal
from learner.inference.targets import Target
from learner.model import Condition, Definition, Demonstration, GripperIs, InGripper, Node
from learner.model.pose import cross
from learner.model.tree import fallback, first_of, guarded, leaf, negated, sequence
from learner.model.vocabulary import RECOVERY_PREFIX
from learner.planning.actions import LearnedActions
from learner.planning.covers import Cover, Covers
from learner.planning.obstacles import Obstacles
from learner.planning.occupations import Occupation, Occupations
from learner.planning.spots import Spots, put_down


class Recovery(Protocol):
    """What a tree does beside what was demonstrated: SubTrees to be used around the steps of a task.

    None stands for no need of one. `definitions` are the further SubTrees that those given use.
    """

    @property
    def definitions(self) -> Sequence[Definition]: ...

    def before(self, subgoal: Subgoal, done: Sequence[Target], instead: Sequence[Subgoal] = ()) -> Definition | None:
        """What makes room before a subgoal, unless it or one `instead` of it is done; targets in `done` hold."""

    def standing(self, subgoal: Subgoal) -> Definition | None:
        """What moves a subgoal's reference away where it was put wrongly, before anything is built in its frame."""

    def otherwise(self, subgoal: Subgoal) -> Definition | None:
        """What follows where a subgoal has failed."""


class NoRecovery:
    """A tree that does what was demonstrated and nothing else."""

    definitions: Sequence[Definition] = ()

    def before(self, subgoal: Subgoal, done: Sequence[Target], instead: Sequence[Subgoal] = ()) -> None:
        return None

    def standing(self, subgoal: Subgoal) -> None:
        return None

    def otherwise(self, subgoal: Subgoal) -> None:
        return None


@dataclass(frozen=True, eq=False)
class PileRecovery:
    """Takes down what covers, frees what is occupied, and stands references on the table again."""

    obstacles: Obstacles
    covers: Covers
    occupations: Occupations
    spots: Spots

    @staticmethod
    def of(
        demonstrations: Sequence[Demonstration],
        actions: LearnedActions,
        targets: Sequence[Target],
        widened: frozenset[tuple[Target, str]] = frozenset(),
    ) -> PileRecovery:
        """The recovery of one task; for `widened` see Occupations."""
        obstacles = Obstacles(demonstrations, actions)
        occupations = Occupations(obstacles, targets, widened)
        return PileRecovery(obstacles, Covers(obstacles, targets), occupations, Spots(obstacles, targets))

    @property
    def definitions(self) -> Sequence[Definition]:
        return [*self.obstacles.definitions, *self.covers.definitions, *self.spots.definitions]

    def before(self, subgoal: Subgoal, done: Sequence[Target], instead: Sequence[Subgoal] = ()) -> Definition | None:
        """The place is freed, the object uncovered, the hand emptied for it.

        The objects of targets in `done` are known to lie where they belong, since earlier siblings have just checked
        it: they do not occupy the place, and do not cover anything unless what they rest on may itself do so.
        """
        target, ids = subgoal.target, self.obstacles.ids
        occupied, covers = self._occupied(subgoal, done), self._covered(target, done)
        if not occupied and not covers:
            return None
        placements = self.obstacles.actions.placements
        finished = [leaf(placements[way.target].achieves) for way in (subgoal, *instead)]
        body = fallback(*finished, self._cleared(target.object, occupied, covers))
        return Definition(f"{RECOVERY_PREFIX}Room_for_{ids[target.object]}_at_{ids[target.frame]}", body)

    def _occupied(self, subgoal: Subgoal, done: Sequence[Target]) -> list[Occupation]:
        """What keeps something from being placed; a reference that was itself placed may have been put upon others."""
        target = subgoal.target
        settled = {other.object for other in done} - {target.object}
        occupied = [condition for condition in self.occupations.of(target) if condition.object not in settled]
        raised = self.covers.raised(subgoal) if self._is_placed(target.frame) else []
        return [*occupied, *(cover.condition for cover in raised if cover.object not in settled)]

    def _covered(self, target: Target, done: Sequence[Target]) -> list[Cover]:
        grounded = self._grounded(done)
        return [cover for cover in self.covers.of(target.object) if cover.object not in grounded]

    def _grounded(self, done: Sequence[Target]) -> set[str]:
        """The objects of targets whose frame cannot be moved by hand, or is grounded itself."""
        grounded: set[str] = set()
        for _ in done:
            grounded |= {t.object for t in done if t.frame not in self.obstacles.picks or t.frame in grounded}
        return grounded

    def _cleared(self, name: str, occupied: Sequence[Occupation], covers: Sequence[Cover]) -> Node:
        """Puts aside what occupies a place and what covers the object that is to come there."""
        held = leaf(InGripper(name))
        uncovered = [sequence(*(_not(cover.condition) for cover in covers))] if covers else []
        clear = sequence(*map(_not, occupied), *(fallback(held, free) for free in uncovered))
        lifts = [guarded(condition, self.covers.lift(condition.object)) for condition in occupied]
        lifts += [guarded(cover.condition, self.covers.off(cover)) for cover in covers]
        away = sequence(put_down(), first_of(lifts))
        return sequence(fallback(clear, away, reactive=False), fallback(held, put_down()))

    def standing(self, subgoal: Subgoal) -> Definition | None:
        """Wrongly is upon something, or on another target's place: what is built there first would have to be taken
        down again. Only for a reference that the task itself leaves where it is.
        """
        frame = subgoal.target.frame
        if self._is_placed(frame):
            return None
        wrongly = [*(cover.condition for cover in self.covers.raised(subgoal)), *self.occupations.astray(frame)]
        if not wrongly:
            return None
        lifts = first_of([guarded(condition, self.covers.lift(frame)) for condition in wrongly])
        body = fallback(sequence(*map(_not, wrongly)), sequence(put_down(), lifts), reactive=False)
        return Definition(f"{RECOVERY_PREFIX}Stand_{self.obstacles.ids[frame]}", body)

    def otherwise(self, subgoal: Subgoal) -> Definition | None:
        """If the hand is still open, the object is tried turned by a quarter.

        It ends in FAILURE, so that the tree begins anew with the object in hand.
        """
        name, turned = subgoal.target.object, self.obstacles.turned
        if name not in turned or subgoal.guards or self._turns_others(name):
            return None
        body = sequence(leaf(GripperIs("open")), leaf(turned[name]))
        return Definition(f"{RECOVERY_PREFIX}Turn_for_{self.obstacles.ids[name]}", Node("ForceFailure", (), (body,)))

    def _turns_others(self, name: str) -> bool:
        """Whether something belongs beside the object, so that how it is turned decides where."""
        others = (t for t in self.occupations.targets if t.object != name and name in t.tied | {t.frame})
        moves = self.obstacles.actions.moves
        rests = np.concatenate([np.empty((0, 3)), *(moves.releases(t.members).rest(name).positions for t in others)])
        up, beside_m = self.obstacles.ups[name], self.obstacles.parameters.beside_m
        return bool((np.linalg.norm(cross(up, rests), axis=1) > beside_m).any())

    def _is_placed(self, name: str) -> bool:
        """Whether the task itself places an object."""
        return any(target.object == name for target in self.occupations.targets)


def _not(condition: Condition) -> Node:
    return negated(leaf(condition))
