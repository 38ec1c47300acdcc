"""Goals by geometry, groups of demonstrations with one goal, and the order in which a group reaches its targets.

The paper's section III-D, with goals compared as sets of targets instead of as text, orders that any demonstration
reverses dropped, and each placement that is given up again kept only as a guard of what was done meanwhile.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from learner.inference.order import orders
from learner.inference.parameters import InferenceParameters
from learner.inference.targets import Target
from learner.model import Demonstration, Pose

Chain = Sequence[Target]


@dataclass(frozen=True)
class Subgoal:
    """A target to reach, and the guards: subgoals whose targets must hold while it is pursued."""

    target: Target
    guards: tuple[Subgoal, ...] = ()

    def targets(self) -> list[Target]:
        """Every target in it, guards first."""
        return [target for guard in self.guards for target in guard.targets()] + [self.target]


@dataclass(frozen=True)
class Group:
    """Demonstrations with one goal: the subgoals in order, and what the gripper holds at the end (None: nothing)."""

    demonstrations: tuple[int, ...]
    subgoals: tuple[Subgoal, ...]
    held: str | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def goal(self) -> frozenset[Target]:
        return frozenset(subgoal.target for subgoal in self.subgoals)


def final_targets(chain: Chain) -> dict[str, Target]:
    """The last target of each object of one demonstration."""
    return {target.object: target for target in chain}


def holding_at_end(demonstration: Demonstration, candidates: Sequence[Target], radius_m: float) -> dict[str, Target]:
    """The candidates that hold at the end of a demonstration though it did not reach them: they held already."""
    found: dict[str, Target] = {}
    for target in candidates:
        world = {**demonstration.initial, **demonstration.final}
        if target.object in world and (target.frame in world or target.frame == demonstration.base_frame):
            base = Pose((0.0, 0.0, 0.0)) if target.frame == demonstration.base_frame else world[target.frame]
            here = (base.inverse() @ world[target.object]).position
            mean = np.mean([rest.position for rest in target.rests], axis=0)
            if np.linalg.norm(np.subtract(here, mean)) < radius_m:
                found.setdefault(target.object, target)
    return found


def ordered(targets: Sequence[Target], chains: Sequence[Chain]) -> list[Target]:
    """The targets in an order that no demonstration contradicts where they agree; else by when they were reached."""
    before = orders(chains)
    ranks = {target: _rank(target, chains) for target in targets}
    left, result = sorted(targets, key=lambda target: ranks[target]), []
    while left:
        free = [t for t in left if not any((other, t) in before for other in left)]
        result.append((free or left)[0])
        left.remove(result[-1])
    return result


def _rank(target: Target, chains: Sequence[Chain]) -> tuple[float, str, tuple[int, ...]]:
    places = [
        (place + 0.5) / len(chain) for chain in chains for place, other in enumerate(chain) if other == target
    ]  # fmt: skip
    return (float(np.mean(places)) if places else 0.0, target.object, target.members)


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


def _left_at(place: int, sequence: Sequence[Target]) -> int:
    """The place at which the object of `sequence[place]` is moved on."""
    later = (other for other in range(place + 1, len(sequence)) if sequence[other].object == sequence[place].object)
    return next(later, len(sequence))


def groups_of(
    demonstrations: Sequence[Demonstration],
    chains: Mapping[int, Chain],
    held: Mapping[int, str],
    parameters: InferenceParameters,
) -> list[Group]:
    """The groups, the one with most demonstrations first.

    A demonstration whose goal is part of another's left the rest as it found it and joins the larger goal. Where some
    goals are shared by enough demonstrations and users, the others are left out: to stop early is not to be done.
    """
    radius_m = parameters.same_goal_m
    finals = {number: final_targets(chain) for number, chain in chains.items()}
    everything = sorted({t for final in finals.values() for t in final.values()}, key=lambda t: (t.object, t.members))
    goals = {
        number: frozenset({**holding_at_end(demonstrations[number], everything, radius_m), **final}.values())
        for number, final in finals.items()
    }
    distinct = [goal for goal in set(goals.values()) if not any(goal < other for other in goals.values())]
    found = []
    for goal in distinct:
        members = tuple(sorted(number for number, other in goals.items() if other <= goal))
        found.append(_group(goal, members, chains, held, demonstrations, goals))
    return _shared(sorted(found, key=lambda g: (-len(g.demonstrations), g.demonstrations)), demonstrations, parameters)


def _shared(
    groups: list[Group], demonstrations: Sequence[Demonstration], parameters: InferenceParameters
) -> list[Group]:
    """The groups that enough demonstrations and users share, with a note on the others; all where none is."""
    everyone = len({demonstration.user for demonstration in demonstrations})

    def enough(group: Group) -> bool:
        users = {demonstrations[number].user for number in group.demonstrations}
        many = len(group.demonstrations) >= parameters.samples_for(len(demonstrations))
        return many and len(users) >= parameters.users_for(everyone)

    kept = [group for group in groups if enough(group)]
    if not kept:
        return groups
    inside = {number for group in kept for number in group.demonstrations}
    ended = {demonstrations[n].demonstration_id for g in groups for n in g.demonstrations if n not in inside}
    notes = tuple(f"demonstration {name} ends as no others do; its goal is left out" for name in sorted(ended))
    return [replace(kept[0], notes=(*kept[0].notes, *notes)), *kept[1:]]


def _group(
    goal: frozenset[Target], members: tuple[int, ...], chains: Mapping[int, Chain], held: Mapping[int, str],
    demonstrations: Sequence[Demonstration], reached: Mapping[int, frozenset[Target]],
) -> Group:  # fmt: skip
    counts = Counter(target for number in members for target in set(chains[number]) - goal)
    usual = [target for target, count in counts.items() if 2 * count > len(members)]
    subgoals, idle = subgoals_of(ordered([*goal, *usual], [chains[number] for number in members]))
    notes = [f"placing {t.object} in {t.frame} only on the way is of no effect and left out" for t in idle]
    for number in members:
        missing = sorted(t.object for t in goal - reached[number])
        if missing:
            name = demonstrations[number].demonstration_id
            notes.append(f"demonstration {name} did not place {', '.join(missing)}; the goal of the others stands")
    kept = Counter(held[number] for number in members if number in held).most_common(1)
    return Group(members, subgoals, kept[0][0] if kept and 2 * kept[0][1] > len(members) else None, tuple(notes))
