"""Our method: the paper's ideas, repaired where they are known to fail.

Moves are cleaned and their labels checked; targets, their frames and contexts come from geometry and evidence; goals
are compared as sets of targets; the tree is small by construction and proven in the world of its own conditions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from learner.errors import NothingLearnedError
from learner.executables import Executables
from learner.groups import Group, groups_of
from learner.learned import Learned, main_id
from learner.model import Demonstration
from learner.moves import Move, moves_of
from learner.parameters import Parameters
from learner.questions import questions
from learner.recovery import Recovery
from learner.synthesis import tree_of
from learner.targets import Target, TargetFinder


def learn_robustly(demonstrations: Sequence[Demonstration], parameters: Parameters) -> Learned:
    """The tree of our method, with what is not known. Raises NothingLearnedError if nothing was moved."""
    moves: list[Move] = []
    notes: list[str] = []
    for number, demonstration in enumerate(demonstrations):
        found, left_out = moves_of(number, demonstration, parameters)
        moves += found
        notes += left_out
    if all(move.put_back for move in moves):
        raise NothingLearnedError("no object was moved in any demonstration: everything was put back where it was")
    finder = TargetFinder(demonstrations, moves, parameters)
    targets = finder.find()
    chains = _chains(len(demonstrations), moves, targets)
    if not any(chains.values()) and any(move.release for move in moves):
        kept = (number for number, move in enumerate(moves) if move.release is not None and not move.put_back)
        targets = [finder.alone(number) for number in kept]
        chains = _chains(len(demonstrations), moves, targets)
    notes += _unsupported(demonstrations, moves, targets)
    held = {move.demonstration: move.object for move in moves if move.release is None}
    pursued = {number: chain for number, chain in chains.items() if chain or number in held}
    groups = groups_of(demonstrations, pursued, held, parameters.least_radius_m * 2)
    actions = Executables(demonstrations, moves, targets, parameters)
    asked = questions(demonstrations, targets, parameters)
    recovery = Recovery(demonstrations, actions, targets)
    tree = tree_of(main_id(demonstrations), groups, actions, recovery)
    notes += [note for group in groups for note in group.notes]
    notes += [f"{t.object} at {t.frame}: {t.verdict.evidence}; {t.verdict.chosen} was corrected to {t.verdict.type}"
              for t in targets if t.verdict.corrected]  # fmt: skip
    return Learned(tree, _report(demonstrations, targets, groups, asked), (*notes, *(q["sentence"] for q in asked)))


def _chains(count: int, moves: Sequence[Move], targets: Sequence[Target]) -> dict[int, list[Target]]:
    """For each demonstration the targets it reached, in order."""
    of = {number: target for target in targets for number in target.members}
    chains: dict[int, list[Target]] = {number: [] for number in range(count)}
    for number, move in enumerate(moves):
        if number in of:
            chains[move.demonstration].append(of[number])
    return chains


_REASONS = {True: "was put back", False: "was put where others do not put it, or did not stay"}


def _unsupported(
    demonstrations: Sequence[Demonstration], moves: Sequence[Move], targets: Sequence[Target]
) -> list[str]:  # fmt: skip
    inside = {number for target in targets for number in target.members}
    return [
        f"demonstration {demonstrations[move.demonstration].demonstration_id}, action {move.release.step}: "
        f"{move.object} {_REASONS[move.put_back]}; not part of the task"
        for number, move in enumerate(moves)
        if move.release is not None and number not in inside
    ]


def _report(
    demonstrations: Sequence[Demonstration],
    targets: Sequence[Target],
    groups: Sequence[Group],
    asked: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:  # fmt: skip
    ids = [demonstration.demonstration_id for demonstration in demonstrations]
    return {
        "actions": [
            {
                "type": target.verdict.type,
                "object": target.object,
                "frame": target.frame,
                "certainty": round(target.certainty, 4),
                "frames": {frame: round(share, 4) for frame, share in target.frames.items()},
                "samples": len(target.members),
                "spread_m": round(target.spread_m, 4),
                "context": target.context,
                "label": target.verdict.evidence,
            }
            for target in targets
        ],
        "groups": [
            {
                "demonstrations": [ids[number] for number in group.demonstrations],
                "goal": [f"{step.target.object} at {step.target.frame}" for step in group.steps],
            }
            for group in groups
        ],
        "questions": list(asked),
        "rest_unseen": sorted(
            {ids[n] for n, d in enumerate(demonstrations) if any(not action.rest_seen for action in d.actions)}
        ),
    }
