"""Recovery without a scene: only the stackings that were demonstrated are known, and objects are points.

What was shown to lie upon an object is lifted off and put aside on one of the spots where objects have lain. All of it
stands in SubTrees whose ID begins with `Recover_`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from learner.inference.goals import Subgoal
from learner.inference.targets import Target
from learner.model import Definition, InGripper, Node, ObjectAt, Place
from learner.model.tree import fallback, first_of, guarded, leaf, negated, sequence
from learner.model.vocabulary import RECOVERY_PREFIX
from learner.planning.obstacles import Obstacles
from learner.planning.rounding import rounded_vector
from learner.planning.spots import Spots, put_down


@dataclass(frozen=True, eq=False)
class DemonstratedRecovery:
    """Takes down what was shown to lie upon something, and frees a stop of what else stops there."""

    obstacles: Obstacles
    targets: Sequence[Target]
    stops: Sequence[Target] = ()

    @property
    def definitions(self) -> Sequence[Definition]:
        return Spots(self.obstacles, self.targets).definitions

    def first(self, subgoals: Sequence[Subgoal]) -> Sequence[Node]:
        return ()

    def before(
        self, subgoal: Subgoal, done: Sequence[Target], instead: Sequence[Subgoal] = ()
    ) -> Node | Definition | None:
        """The object is uncovered, and the hand emptied for it; what lies where it belongs does not cover it."""
        target, ids, placements = subgoal.target, self.obstacles.ids, self.obstacles.actions.placements
        settled = self._grounded(done)
        covers = [cover for cover in self._covers if cover.frame == target.object and cover.object not in settled]
        left = self._left_at(target)
        if not covers and not left:
            return None
        finished = [leaf(placements[way.target].achieves) for way in (subgoal, *instead)]
        body = fallback(*finished, self._cleared(target.object, covers, left))
        return Definition(f"{RECOVERY_PREFIX}Room_for_{ids[target.object]}_at_{ids[target.frame]}", body)

    def standing(self, subgoal: Subgoal) -> Sequence[Node]:
        return ()

    def otherwise(self, subgoal: Subgoal) -> Sequence[Node]:
        return ()

    @cached_property
    def _covers(self) -> list[ObjectAt]:
        """What lay upon what when it was let go there."""
        upon = {(target.object, *target.upon) for target in self.targets if target.upon}
        radius_m = self.obstacles.parameters.cover_radius_m
        shown = [ObjectAt(name, under, rounded_vector(at), radius_m) for name, under, at in sorted(upon)]
        return [cover for cover in shown if {cover.object, cover.frame} <= self.obstacles.picks.keys()]

    def _grounded(self, done: Sequence[Target]) -> set[str]:
        """The objects of targets whose frame cannot be moved by hand, or is grounded itself."""
        grounded: set[str] = set()
        for _ in done:
            grounded |= {t.object for t in done if t.frame not in self.obstacles.picks or t.frame in grounded}
        return grounded

    def _left_at(self, target: Target) -> list[ObjectAt]:
        """The stops of other objects at a target: one of them may have been left there."""
        placements, near_m = self.obstacles.actions.placements, self.obstacles.parameters.cover_radius_m
        here, others = placements[target], [stop for stop in self.stops if stop.object != target.object]
        places = [place for stop in others if isinstance(place := placements[stop], Place)]
        same = [place for place in places if place.frame == here.frame and math.dist(place.rest, here.rest) < near_m]
        return [place.achieves for place in same] if isinstance(here, Place) else []

    def _cleared(self, name: str, covers: Sequence[ObjectAt], left: Sequence[ObjectAt]) -> Node:
        held = leaf(InGripper(name))
        uncovered = [fallback(held, sequence(*(negated(leaf(cover)) for cover in covers)))] if covers else []
        free = [*(negated(leaf(other)) for other in left), *uncovered]
        clear = free[0] if len(free) == 1 else sequence(*free)
        lifts = first_of([guarded(other, self._off(other)) for other in (*left, *covers)])
        return sequence(fallback(clear, sequence(put_down(), lifts), reactive=False), fallback(held, put_down()))

    def _off(self, cover: ObjectAt, below: tuple[str, ...] = ()) -> Node:
        """Picks a covering object; what was shown to lie upon that one goes first."""
        higher = [c for c in self._covers if c.frame == cover.object and c.object not in below]
        lifts = [guarded(other, self._off(other, (*below, cover.object))) for other in higher]
        return first_of([*lifts, leaf(self.obstacles.picks[cover.object])])
