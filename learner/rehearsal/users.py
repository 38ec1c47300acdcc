"""How well the tree of the others does what each user showed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from learner.inference.understanding import Understanding
from learner.inference.users import understood_of
from learner.model import ObjectAt
from learner.model.condition import ObjectRoughlyAt
from learner.planning.draft import Draft
from learner.rehearsal.goal import Goal, Relation, on_stage
from learner.rehearsal.rehearsal import Actor, perform
from learner.rehearsal.rollouts import Rollout
from learner.rehearsal.share import Share
from learner.rehearsal.stage import Stage, spread_evenly

Step = tuple[str, int]
"""A pick: the id of its demonstration, and its place in it."""


def success_without(draft: Draft, stage: Stage) -> dict[str, Share | None]:
    """For each user, in how many of their demonstrations the tree of the others does as they did.

    The tree without recovery begins where the user began, in the kinematic world. It has to bring to where it lay in
    the end what belongs to a target of all, or what the user alone puts there time and again; a demonstration without
    any such thing is none that it does. None where the others' demonstrations make no tree, or the stage no start.
    """
    return {user: _success(user, others, draft, stage) for user, others in draft.without.items()}


def _success(user: str, others: Understanding | None, draft: Draft, stage: Stage) -> Share | None:
    if others is None:
        return None
    numbers = stage.parameters.users
    shown, most = draft.understood.samples, max(numbers.least_trials, numbers.most_trials // len(draft.without))
    mine = spread_evenly(np.flatnonzero(shown.users == user).tolist(), most)
    starts = {number: start for number in mine if (start := stage.start(shown.demonstrations[number]))}
    if not starts:
        return None
    actor = Actor(stage.root(Draft(others, draft.parameters, {}).nominal_tree().flattened()))
    ends = _ends(user, list(starts), draft, stage)
    done = 0
    for number, start in starts.items():
        goals = [ends[start.demonstration_id]] if start.demonstration_id in ends else []
        rollout = Rollout(start.demonstration_id, start.spots)
        done += bool(goals) and perform(rollout, actor, stage, goals, number).done
    return Share(done, len(starts))


def _ends(user: str, tried: Sequence[int], draft: Draft, stage: Stage) -> dict[str, Goal]:
    """By demonstration, where the user left what belongs to the task, or what they put there time and again."""
    understood = draft.understood
    names = {understood.demonstrations[number].demonstration_id for number in tried}
    moves, places = understood.moves, _reached(understood, names)
    shown = np.flatnonzero(np.isin(moves.demonstration, tried)).tolist()
    if any(_pick(number, understood) not in places for number in shown):
        alone = understood_of(understood.samples.users == user, understood)
        places = {**(_reached(alone, names) if alone else {}), **places}
    ends: dict[str, dict[str, Relation]] = {}
    for number in shown:
        step = _pick(number, understood)
        if step in places:
            ends.setdefault(step[0], {})[str(moves.object[number])] = places[step]
    most = 2 * len(understood.targets)
    return {
        name: Goal(tuple(on_stage(end, stage) for end in found.values()), actions=most) for name, found in ends.items()
    }


def _reached(understood: Understanding, names: set[str]) -> dict[Step, Relation]:
    """Where an object came to rest that was brought to a supported target, in the demonstrations of these names."""
    moves = understood.moves
    named = np.array([each.demonstration_id in names for each in understood.demonstrations], dtype=np.bool_)
    found: dict[Step, Relation] = {}
    for target in understood.targets:
        kind = ObjectAt if target.type == "place" else ObjectRoughlyAt
        members = np.array(target.members, dtype=np.intp)
        for row in np.flatnonzero(named[moves.demonstration[members]]) if target.supported else ():
            rest = target.rests.pose(int(row)).position
            found[_pick(int(members[row]), understood)] = kind(target.object, target.frame, rest)
    return found


def _pick(number: int, understood: Understanding) -> Step:
    """The pick of a move."""
    moves = understood.moves
    return moves.name(number), int(moves.samples.step[moves.pick[number]])
