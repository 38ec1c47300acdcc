"""How well the tree of the others does what each user showed."""

from __future__ import annotations

from learner.errors import NothingLearnedError
from learner.inference.understanding import Understanding, understand
from learner.model import ObjectAt
from learner.model.condition import ObjectRoughlyAt
from learner.planning.draft import Draft
from learner.rehearsal.goal import Goal, Relation, on_stage
from learner.rehearsal.rehearsal import Actor, perform
from learner.rehearsal.rollouts import Rollout
from learner.rehearsal.stage import Stage


def success_without(draft: Draft, stage: Stage) -> dict[str, str | None]:
    """For each user, in how many of their demonstrations the tree of the others does as they did, as "2 of 3".

    The tree without recovery begins where the user began, in the kinematic world. It has to bring to where it lay in
    the end what belongs to a target of all, or what the user alone puts there time and again; a demonstration without
    any such thing is none that it does. None where the others' demonstrations make no tree, or the stage no start.
    """
    return {user: _success(user, others, draft, stage) for user, others in draft.without.items()}


def _success(user: str, others: Understanding | None, draft: Draft, stage: Stage) -> str | None:
    mine = [n for n, demonstration in enumerate(draft.understood.demonstrations) if demonstration.user == user]
    starts = {start.demonstration_id: start for start in stage.starts}
    ids = {n: draft.understood.demonstrations[n].demonstration_id for n in mine}
    known = [n for n in mine if ids[n] in starts]
    if others is None or not known:
        return None
    actor = Actor(stage.root(Draft(others, draft.parameters, {}).nominal_tree().flattened()))
    ends = _ends(user, draft, stage)
    done = [perform(Rollout(ids[n], starts[ids[n]].spots), actor, stage, [ends[n]], n).done for n in known if n in ends]
    return f"{sum(done)} of {len(known)}"


def _ends(user: str, draft: Draft, stage: Stage) -> dict[int, Goal]:
    """By demonstration, where the user left what belongs to the task, or what they put there time and again."""
    understood = draft.understood
    places = {**_reached(_alone(user, draft)), **_reached(understood)}
    ends: dict[int, dict[str, Relation]] = {}
    for move in understood.moves:
        name = understood.demonstrations[move.demonstration].demonstration_id
        if understood.demonstrations[move.demonstration].user == user and (name, move.pick.step) in places:
            ends.setdefault(move.demonstration, {})[move.object] = places[name, move.pick.step]
    return {
        number: Goal(tuple(on_stage(end, stage) for end in found.values()), actions=2 * len(understood.targets))
        for number, found in ends.items()
    }


def _alone(user: str, draft: Draft) -> Understanding | None:
    """What a user's own demonstrations mean; None if they mean nothing."""
    mine = [demonstration for demonstration in draft.understood.demonstrations if demonstration.user == user]
    try:
        return understand(mine, draft.understood.parameters)
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
