"""Goals by geometry, groups of demonstrations with one goal, and the order in which a group reaches its targets.

The paper's section III-D, with goals compared as sets of targets instead of as text, orders that any demonstration
reverses dropped, and each placement that is given up again kept as a guard of what was done meanwhile, or, where
nothing was, as a stop on the way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile

import numpy as np

from learner.inference.chains import Chains, ordered
from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Names, Samples, posed
from learner.inference.targets import Target
from learner.model.poses import Mask, Rows

Goal = frozenset[Target]


@dataclass(frozen=True)
class Subgoal:
    """A target to reach, the guards: subgoals whose targets must hold while it is pursued, and the stops: targets that
    its object is brought to on the way, in this order.
    """

    target: Target
    guards: tuple[Subgoal, ...] = ()
    stops: tuple[Target, ...] = ()

    def every(self) -> list[Subgoal]:
        """Every subgoal in it, guards first."""
        return [*(each for guard in self.guards for each in guard.every()), self]

    def targets(self) -> list[Target]:
        """Every target in it, guards first."""
        return [target for each in self.every() for target in (*each.stops, each.target)]


@dataclass(frozen=True)
class Group:
    """Demonstrations with one goal: the subgoals in order, and what the gripper holds at the end (None: nothing).

    `idle` are targets that most of them reach only on the way to where the object stood at the start.
    """

    demonstrations: tuple[int, ...]
    subgoals: tuple[Subgoal, ...]
    held: str | None = None
    notes: tuple[str, ...] = field(default=())
    idle: tuple[Target, ...] = ()

    @property
    def goal(self) -> Goal:
        return frozenset(subgoal.target for subgoal in self.subgoals)


def subgoals_of(sequence: Sequence[Target]) -> tuple[tuple[Subgoal, ...], list[Target]]:
    """The goal's subgoals in the order of a sequence of targets, and the targets that guard nothing.

    A target that its object leaves again is a guard of the next goal after it, if it still holds when that is
    reached, else of the next subgoal before that goal for which it holds (paper, section III-D: constraints become
    preconditions; a constraint that an earlier subgoal has just established is not repeated).
    """
    last = {target.object: place for place, target in enumerate(sequence)}
    subgoals: list[Subgoal] = []
    idle: list[Target] = []
    segment: list[int] = []
    for place, target in enumerate(sequence):
        if last[target.object] != place:
            segment.append(place)
            continue
        guards, left = _guards(place, segment, sequence)
        subgoals.append(Subgoal(target, guards))
        idle += [sequence[other] for other in left]
        segment = []
    return tuple(subgoals), idle


def _guards(place: int, segment: Sequence[int], sequence: Sequence[Target]) -> tuple[tuple[Subgoal, ...], list[int]]:
    """The guards of the target at `place` among the places of a segment before it, and the places left over."""
    in_force = [other for other in segment if place < _left_at(other, sequence)]
    others = [other for other in segment if other not in in_force]
    guards = []
    for other in in_force:
        earlier = [item for item in others if item < other]
        nested, others_left = _guards(other, earlier, sequence)
        others = [item for item in others if item > other or item in others_left]
        guards.append(Subgoal(sequence[other], nested))
    return tuple(guards), others


def _with_stops(
    subgoals: Sequence[Subgoal], idle: Collection[Target], sequence: Sequence[Target]
) -> tuple[Subgoal, ...]:
    """The subgoals, each with the idle targets that its object reaches since the one of it before."""
    return tuple(
        replace(
            subgoal,
            guards=_with_stops(subgoal.guards, idle, sequence),
            stops=_stops(subgoal.target, idle, sequence),
        )
        for subgoal in subgoals
    )


def _stops(target: Target, idle: Collection[Target], sequence: Sequence[Target]) -> tuple[Target, ...]:
    """The idle targets of an object right before one that is not."""
    before = [other for other in sequence[: sequence.index(target)] if other.object == target.object]
    return tuple(reversed(list(takewhile(lambda other: other in idle, reversed(before)))))


def _left_at(place: int, sequence: Sequence[Target]) -> int:
    """The place at which the object of `sequence[place]` is moved on."""
    later = (other for other in range(place + 1, len(sequence)) if sequence[other].object == sequence[place].object)
    return next(later, len(sequence))


def groups_of(samples: Samples, chains: Chains, held: Names, parameters: InferenceParameters) -> list[Group]:
    """The groups, the one with most demonstrations first.

    `held` is what each demonstration (k,) ends with in the gripper, "" for nothing.
    A demonstration whose goal is part of another's left the rest as it found it and joins the larger goal. Where some
    goals are shared by enough demonstrations and users, the others are left out: to stop early is not to be done.
    """
    pursued = np.flatnonzero((chains.lengths > 0) | (held != ""))
    goals, of = _goals(samples, chains, pursued, parameters.same_goal_m)
    distinct = [goal for goal in goals if not any(goal < other for other in goals)]
    found = []
    for goal in distinct:
        inside = np.array([other <= goal for other in goals], dtype=np.bool_)[of]
        lacking = [tuple(sorted(target.object for target in goal - other)) for other in goals]
        missing = [lacking[number] for number in of[inside].tolist()]
        found.append(_group(goal, pursued[inside], missing, chains, held, samples, parameters.same_goal_m))
    return _shared(sorted(found, key=lambda g: (-len(g.demonstrations), g.demonstrations)), samples, parameters)


def _goals(samples: Samples, chains: Chains, pursued: Rows, radius_m: float) -> tuple[list[Goal], Rows]:
    """The distinct goals of these demonstrations, and which of them each has: for every object the last target that it
    was brought to, else the first that it lies at in the end: it was there already.
    """
    finals = [{target.object: target for target in chain} for chain in chains.distinct]
    everything = sorted({t for final in finals for t in final.values()}, key=lambda t: (t.object, t.members))
    has = np.zeros((len(pursued), len(everything)), dtype=np.bool_)
    for column, target in enumerate(everything):
        has[:, column] = _holds_at_end(target, samples, radius_m)[pursued]
    reached = np.array(
        [[final.get(target.object) == target for target in everything] for final in finals], dtype=np.bool_
    )
    moved = np.array([[target.object in final for target in everything] for final in finals], dtype=np.bool_)
    which = chains.of[pursued]
    has = np.where(moved[which], reached[which], _first_of_each_object(has, everything)) if everything else has
    rows, of = np.unique(has, axis=0, return_inverse=True)
    return [frozenset(t for t, one in zip(everything, row, strict=True) if one) for row in rows], of.reshape(-1)


def _first_of_each_object(has: Mask, targets: Sequence[Target]) -> Mask:
    """Of several targets (n, t) of one object that hold, the first."""
    kept = has.copy()
    for column, target in enumerate(targets):
        earlier = [other for other in range(column) if targets[other].object == target.object]
        kept[:, column] &= ~has[:, earlier].any(axis=1)
    return kept


def _holds_at_end(target: Target, samples: Samples, radius_m: float) -> Mask:
    """In which demonstrations (k,) an object lies at a target in the end, whoever brought it there."""
    here = (samples.ends(target.frame).inverse() @ samples.ends(target.object)).positions
    return np.asarray(np.linalg.norm(here - target.rests.positions.mean(axis=0), axis=1) < radius_m)


def began_at(target: Target, members: Rows, samples: Samples, radius_m: float) -> bool:
    """Whether the object lay at a target already when most of these demonstrations began."""
    seen, count = samples.columns.begins, len(samples.columns.demonstrations)
    frame, own = (posed(name, samples.base, seen, count)[samples.numbers] for name in (target.frame, target.object))
    here = (frame.inverse() @ own).positions[members]
    away_m = np.linalg.norm(here - target.rests.positions.mean(axis=0), axis=1)
    return bool(2 * (away_m < radius_m).sum() > len(members))


def _shared(groups: list[Group], samples: Samples, parameters: InferenceParameters) -> list[Group]:
    """The groups that enough demonstrations and users share, with a note on the others; all where none is."""
    everyone, count = len(np.unique(samples.users)), len(samples.numbers)

    def enough(group: Group) -> bool:
        users = np.unique(samples.users[list(group.demonstrations)])
        many = len(group.demonstrations) >= parameters.samples_for(count)
        return many and len(users) >= parameters.users_for(everyone)

    kept = [group for group in groups if enough(group)]
    if not kept:
        return groups
    inside = {number for group in kept for number in group.demonstrations}
    left_out = {number for group in groups for number in group.demonstrations} - inside
    ended = sorted(samples.demonstrations[number].demonstration_id for number in left_out)
    notes = tuple(f"demonstration {name} ends as no others do; its goal is left out" for name in ended)
    return [replace(kept[0], notes=(*kept[0].notes, *notes)), *kept[1:]]


def _group(
    goal: Goal, members: Rows, missing: Sequence[tuple[str, ...]], chains: Chains, held: Names, samples: Samples,
    radius_m: float,
) -> Group:  # fmt: skip
    """The group of the demonstrations in `members` (m,), of whose goal each left the objects in `missing` alone."""
    shown = chains.select(members)
    usual = [target for target, count in shown.counts().items() if target not in goal and 2 * count > len(members)]
    sequence = ordered([*goal, *usual], shown)
    subgoals, idle = subgoals_of(sequence)
    home = {target.object for target in goal if began_at(target, members, samples, radius_m)}
    stops = {target for target in idle if target.object not in home}
    notes = []
    for number, names in zip(members, missing, strict=True):
        if names:
            name = samples.demonstrations[number].demonstration_id
            notes.append(f"demonstration {name} did not place {', '.join(names)}; the goal of the others stands")
    for number, stop in ((number, stop) for stop in idle if stop in stops for number in members):
        if stop not in chains.distinct[chains.of[number]]:
            name = samples.demonstrations[number].demonstration_id
            notes.append(
                f"demonstration {name} did not bring {stop.object} to {stop.frame}; the tree does, as the others"
            )
    kept = Counter(held[members][held[members] != ""].tolist()).most_common(1)
    in_hand = kept[0][0] if kept and 2 * kept[0][1] > len(members) else None
    subgoals = _with_stops(subgoals, stops, sequence)
    return Group(tuple(members.tolist()), subgoals, in_hand, tuple(notes), tuple(t for t in idle if t not in stops))
