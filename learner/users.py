"""Who agrees: for each of several users what the tree would mean without them, and which of their actions differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from learner.errors import NothingLearnedError
from learner.goal import Goal, Relation, on_stage
from learner.imagination import Rollout
from learner.model import ObjectAt
from learner.model.condition import ObjectRoughlyAt
from learner.parameters import Parameters
from learner.plan import Plan
from learner.rehearsal import Actor, perform
from learner.stage import Stage
from learner.understanding import Understanding, understand


def understood_without(understood: Understanding, parameters: Parameters) -> dict[str, Understanding | None]:
    """For each of several users, by name, what the demonstrations of the others mean.

    None where they are too few to make a cluster, or mean nothing; empty for a single user.
    """
    users = sorted({demonstration.user for demonstration in understood.demonstrations})
    return {user: _of_others(user, understood, parameters) for user in users} if len(users) > 1 else {}


def _of_others(user: str, understood: Understanding, parameters: Parameters) -> Understanding | None:
    others = [demonstration for demonstration in understood.demonstrations if demonstration.user != user]
    try:
        return understand(others, parameters) if len(others) >= parameters.min_samples else None
    except NothingLearnedError:
        return None


def agreement(understood: Understanding, without: Mapping[str, Understanding | None]) -> list[dict[str, Any]]:
    """One entry a user, by name; empty for a single user.

    `same_without` tells whether leaving the user out gives the same goals (None where the others' mean nothing);
    `differs` names the objects that the user put where the others do not.
    """
    return [_of_user(user, understood, others) for user, others in without.items()]


def _of_user(user: str, understood: Understanding, others: Understanding | None) -> dict[str, Any]:
    mine = [n for n, demonstration in enumerate(understood.demonstrations) if demonstration.user == user]
    strange = [understood.moves[number] for number in understood.strange]
    differs = sorted({move.object for move in strange if move.demonstration in mine and not move.put_back})
    same = None if others is None else others.meaning == understood.meaning
    return {
        "user": user,
        "demonstrations": len(mine),
        "differs": differs,
        "same_without": same,
        "sentence": _sentence(user, differs, same),
    }


def _sentence(user: str, differs: list[str], same: bool | None) -> str | None:
    if differs:
        return f"user {user} puts {', '.join(differs)} elsewhere than the others"
    return None if same is not False else f"without user {user} the demonstrations of the others mean another goal"


def success_without(plan: Plan, stage: Stage) -> dict[str, str | None]:
    """For each user, in how many of their demonstrations the tree of the others does as they did, as "2 of 3".

    The tree without recovery begins where the user began, in the kinematic world. It has to bring to where it lay in
    the end what belongs to a target of all, or what the user alone puts there time and again; a demonstration without
    any such thing is none that it does. None where the others' demonstrations make no tree, or the stage no start.
    """
    return {user: _success(user, others, plan, stage) for user, others in plan.without.items()}


def _success(user: str, others: Understanding | None, plan: Plan, stage: Stage) -> str | None:
    mine = [n for n, demonstration in enumerate(plan.understood.demonstrations) if demonstration.user == user]
    starts = {start.demonstration_id: start for start in stage.starts}
    ids = {n: plan.understood.demonstrations[n].demonstration_id for n in mine}
    known = [n for n in mine if ids[n] in starts]
    if others is None or not known:
        return None
    actor = Actor(stage.root(Plan(others, plan.parameters, {}).nominal_tree().flattened()))
    ends = _ends(user, plan, stage)
    done = [perform(Rollout(ids[n], starts[ids[n]].spots), actor, stage, [ends[n]], n).done for n in known if n in ends]
    return f"{sum(done)} of {len(known)}"


def _ends(user: str, plan: Plan, stage: Stage) -> dict[int, Goal]:
    """By demonstration, where the user left what belongs to the task, or what they put there time and again."""
    understood = plan.understood
    places = {**_reached(_alone(user, plan)), **_reached(understood)}
    ends: dict[int, dict[str, Relation]] = {}
    for move in understood.moves:
        name = understood.demonstrations[move.demonstration].demonstration_id
        if understood.demonstrations[move.demonstration].user == user and (name, move.pick.step) in places:
            ends.setdefault(move.demonstration, {})[move.object] = places[name, move.pick.step]
    return {
        number: Goal(tuple(on_stage(end, stage) for end in found.values()), actions=2 * len(understood.targets))
        for number, found in ends.items()
    }


def _alone(user: str, plan: Plan) -> Understanding | None:
    """What a user's own demonstrations mean; None if they mean nothing."""
    mine = [demonstration for demonstration in plan.understood.demonstrations if demonstration.user == user]
    try:
        return understand(mine, plan.parameters)
    except NothingLearnedError:
        return None


def _reached(understood: Understanding | None) -> dict[tuple[str, int], Relation]:
    """By demonstration and step of the pick, where an object came to rest that was brought to a supported target."""
    found: dict[tuple[str, int], Relation] = {}
    for target in understood.targets if understood else ():
        kind = ObjectAt if target.verdict.type == "place" else ObjectRoughlyAt
        for number, rest in zip(target.members, target.rests, strict=True) if target.supported else ():
            assert understood is not None
            move = understood.moves[number]
            name = understood.demonstrations[move.demonstration].demonstration_id
            found[name, move.pick.step] = kind(target.object, target.frame, rest.position)
    return found
