"""Our method: the paper's ideas, repaired where they are known to fail.

Moves are cleaned and their labels checked; targets, their frames and contexts come from geometry and evidence; goals
are compared as sets of targets; the tree is small by construction and proven in the world of its own conditions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from learner.inference.goals import Group
from learner.inference.moves import Moves
from learner.inference.understanding import Understanding, understand
from learner.inference.users import agreement, understood_without
from learner.learned import Learned
from learner.model import Demonstration
from learner.model.doubt import Doubt
from learner.parameters import Parameters
from learner.planning.draft import Draft
from learner.regularities.doubting import asked_about, doubts_about
from learner.regularities.questions import questions
from learner.stages import UNSEEN, Stages

_REASONS = {True: "was put back", False: "was put where others do not put it, or did not stay"}


def learn_robustly(demonstrations: Sequence[Demonstration], parameters: Parameters, stages: Stages = UNSEEN) -> Learned:
    """The tree of our method, with what is not known. Raises NothingLearnedError if nothing was moved."""
    understood = understand(demonstrations, parameters.inference, stages)
    return stages.run("plan", lambda: _planned(understood, demonstrations, parameters))


def _planned(understood: Understanding, demonstrations: Sequence[Demonstration], parameters: Parameters) -> Learned:
    draft = Draft(understood, parameters.planning, understood_without(understood))
    asked = questions(demonstrations, understood.targets, parameters.inference, understood.groups)
    users = agreement(understood, draft.without)
    doubts = doubts_about(understood, draft.actions, parameters.regularities)
    asked += asked_about(understood, draft.actions, doubts, parameters.regularities)
    report, notes = _report(understood, asked, users), _notes(understood, doubts, asked, users)
    tree = draft.tree()
    grasps = draft.grasps if "FindGrasp" in tree.leaves else ()
    return Learned(tree, report, notes, parameters, doubts=doubts, grasps=grasps, draft=draft)


def _notes(
    understood: Understanding, doubts: Sequence[Doubt], asked: Sequence[Mapping[str, Any]],
    users: Sequence[Mapping[str, Any]],
) -> tuple[str, ...]:  # fmt: skip
    """Sentences for a person: what was left out, corrected, disagreed on, and what to show next.

    What a doubt tells of many demonstrations is not said of each of them again.
    """
    told = {(identifier, doubt.object) for doubt in doubts for identifier in doubt.demonstrations}
    left_out, moves = understood.left_out, understood.moves
    corrected = (
        f"{t.object} at {t.frame}: {t.label.evidence}; {t.label.chosen} was corrected to {t.type}"
        for t in understood.targets
        if t.label.corrected
    )
    return (
        *(left_out.sentence(n) for n in range(len(left_out.moves)) if _key(left_out.moves, n) not in told),
        *(_strange(understood, number) for number in understood.strange if _key(moves, number) not in told),
        *(note for group in understood.groups for note in group.notes),
        *corrected,
        *(user["sentence"] for user in users if user["sentence"]),
        *(question["sentence"] for question in asked),
    )


def _key(moves: Moves, number: int) -> tuple[str, str]:
    """The demonstration and the object of a move."""
    return moves.name(number), str(moves.object[number])


def _strange(understood: Understanding, number: int) -> str:
    moves = understood.moves
    name, reason = moves.object[number], _REASONS[bool(moves.put_back[number])]
    where = f"demonstration {moves.name(number)}, action {moves.last_step(number)}"
    return f"{where}: {name} {reason}; not part of the task"


def _report(
    understood: Understanding, asked: Sequence[Mapping[str, Any]], users: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    demonstrations = understood.demonstrations
    ids = [demonstration.demonstration_id for demonstration in demonstrations]
    return {
        "actions": [
            {
                "type": target.type,
                "object": target.object,
                "frame": target.frame,
                "certainty": round(target.certainty, 4) if target.supported else None,
                "frames": {frame: round(share, 4) for frame, share in target.frames.items()},
                "samples": len(target.members),
                "spread_m": round(target.spread_m, 4),
                "context": target.context,
                "label": target.label.evidence,
            }
            for target in understood.targets
        ],
        "groups": [
            {
                "demonstrations": [ids[number] for number in group.demonstrations],
                "goal": [f"{subgoal.target.object} at {subgoal.target.frame}" for subgoal in group.subgoals],
                **_stops(group),
            }
            for group in understood.groups
        ],
        "questions": list(asked),
        "users": list(users),
        "rest_unseen": sorted(
            {ids[n] for n, d in enumerate(demonstrations) if any(not action.rest_seen for action in d.actions)}
        ),
    }


def _stops(group: Group) -> dict[str, Any]:
    """Where objects are brought on the way, if anywhere."""
    stops = [stop for subgoal in group.subgoals for each in subgoal.every() for stop in each.stops]
    return {"stops": [f"{stop.object} at {stop.frame}" for stop in stops]} if stops else {}
