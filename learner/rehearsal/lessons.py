"""What a rehearsal teaches the planner: each failed rollout is a counterexample, and most tell what was missing.

Where placing fails upon contact with something that already lies where it belongs, or something is placed again and
again upon what is still to be moved, the order is wrong (`before`).

A radius is none of them: it is as wide already as the spread of the demonstrations and what must be told apart allow.
What does not come to rest within it in a simulation says that the simulation is wrong, or the task is not understood.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

from learner.inference.targets import Target
from learner.model import Drop, Place, Tree
from learner.planning.repairs import NOTHING, Repairs
from learner.rehearsal.goal import Goal, holds
from learner.rehearsal.parameters import LessonParameters
from learner.rehearsal.rehearsal import RELEASES, Rehearsal, RolloutResult
from learner.simulation.gravity import Body


@dataclass(frozen=True)
class Candidate:
    """A tree, what it was repaired by, and how it rehearsed."""

    tree: Tree
    repairs: Repairs
    rehearsal: Rehearsal


def candidates(
    first: Tree, plan: Callable[[Repairs], Tree], rehearse: Callable[[Tree], Rehearsal],
    propose: Callable[[Sequence[RolloutResult], Repairs], Sequence[Repairs]], trials: int = LessonParameters.trials,
) -> list[Candidate]:  # fmt: skip
    """The first tree, then each repaired one that rehearses better than all before it.

    At most so many `trials` are made. Of the repairs proposed the first is taken that makes it no worse; one that is as
    good is repaired further, if its failures teach more.
    """
    last = Candidate(first, NOTHING, rehearse(first))
    found, left = [last], trials
    while left:
        options = (last.repairs | option for option in propose(last.rehearsal.failures, last.repairs))
        others = islice((repairs for repairs in options if repairs != last.repairs), left)
        better = None
        for repairs in others:
            left -= 1
            tree = plan(repairs)
            candidate = Candidate(tree, repairs, rehearse(tree))
            if float(candidate.rehearsal.share) >= float(last.rehearsal.share):
                better = candidate
                break
        if better is None:
            break
        found += [better] if float(better.rehearsal.share) > float(last.rehearsal.share) else []
        last = better
    return found


class Lessons:
    """Proposes repairs for the failures of one plan.

    `placements` are by target; `orders` are the targets of each group as they are pursued now, given what is repaired;
    `goals` what was rehearsed; `bodies` what can be in the way.
    """

    def __init__(
        self,
        placements: Mapping[Target, Place | Drop],
        orders: Callable[[Repairs], Sequence[Sequence[Target]]],
        goals: Sequence[Goal],
        bodies: Mapping[str, Body],
        parameters: LessonParameters | None = None,
    ) -> None:
        self.placements, self.orders = placements, orders
        self.goals, self.bodies, self.parameters = goals, bodies, parameters or LessonParameters()
        self.known = NOTHING

    def of(self, failures: Sequence[RolloutResult], known: Repairs = NOTHING) -> Sequence[Repairs]:
        """The repairs that failed runs of a tree speak for, which was made with those `known`."""
        seen = self._seen(failures, known)
        return [] if seen == NOTHING else [seen]

    def _seen(self, failures: Sequence[RolloutResult], known: Repairs) -> Repairs:
        found, self.known = NOTHING, known
        for result in failures:
            for repair in (*self._contacts(result), *self._undone(result)):
                found |= repair
        return found

    def _contacts(self, result: RolloutResult) -> Iterator[Repairs]:
        for (kind, name, frame, failure), times in result.failing.items():
            met = failure.with_ if failure.kind == "contact" else None
            if kind in RELEASES and met is not None and met in self.bodies and times >= self.parameters.often:
                yield from (self._contact(target, met, result) for target in self._targets(name, frame))

    def _contact(self, target: Target, met: str, result: RolloutResult) -> Repairs:
        """What is met lies where it belongs, and came too early."""
        own = [t for t in self.placements if t.object == met and self._lies_at(t, result)]
        return Repairs(frozenset((target, other) for other in own))

    def _lies_at(self, target: Target, result: RolloutResult) -> bool:
        relations = (relation for goal in self.goals for relation in goal.relations)
        own = (r for r in relations if (r.object, r.frame) == (target.object, target.frame))
        return any(holds(relation, result.world) for relation in own)

    def _undone(self, result: RolloutResult) -> Iterator[Repairs]:
        """What is placed again and again upon something that is still to be moved waits until that was moved."""
        placed = Counter(result.placed)
        for order in self.orders(self.known):
            for place, target in enumerate(order):
                if placed[target.object, target.frame] >= self.parameters.often:
                    under = {target.frame, *(target.upon or ())[:1]}
                    later = [other for other in order[place + 1 :] if other.object in under]
                    yield Repairs(frozenset((other, target) for other in later))

    def _targets(self, name: str, frame: str) -> list[Target]:
        return [target for target in self.placements if (target.object, target.frame) == (name, frame)]
