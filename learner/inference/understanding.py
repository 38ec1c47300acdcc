"""What the demonstrations mean: moves, targets, and groups with one goal each, before any tree is built."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from learner.errors import NothingLearnedError
from learner.inference.chains import chains_of
from learner.inference.finding import find_fleeting, find_passed, find_targets
from learner.inference.goals import Group, groups_of
from learner.inference.moves import LeftOut, Moves, moves_of
from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Names, Samples
from learner.inference.targets import Target, alone
from learner.inference.visits import with_visits
from learner.model import Demonstration
from learner.model.poses import Rows
from learner.stages import UNSEEN, Stages

Meaning = frozenset[frozenset[tuple[str, str, str]]]
"""The goals of all groups, each as (object, type, frame) of its targets; of frames that are rigid by the task the
first by name, since any of them means the same."""


@dataclass(frozen=True)
class Understanding:
    """What was understood of some demonstrations with these `parameters`.

    `strange` are the numbers of moves that belong to no target; `left_out` moves that do not count, `passed` the
    targets among those of them that were moved on at once, and are no steps of the task; `fleeting`
    are targets of strange moves at which the object did not stay.
    """

    parameters: InferenceParameters
    moves: Moves
    targets: tuple[Target, ...]
    groups: tuple[Group, ...]
    strange: tuple[int, ...]
    left_out: LeftOut
    passed: tuple[Target, ...]
    fleeting: tuple[Target, ...]

    @property
    def samples(self) -> Samples:
        """Every action that was shown."""
        return self.moves.samples

    @property
    def demonstrations(self) -> tuple[Demonstration, ...]:
        """What was shown."""
        return self.moves.samples.demonstrations

    @property
    def meaning(self) -> Meaning:
        return frozenset(
            frozenset((t.object, t.type, min(t.tied | {t.frame})) for t in group.goal) for group in self.groups
        )


def understand(
    demonstrations: Sequence[Demonstration], parameters: InferenceParameters, stages: Stages = UNSEEN
) -> Understanding:
    """Moves cleaned, targets found, goals grouped.

    Raises NothingLearnedError if nothing was moved, or the demonstrations differ in their base frame.
    """
    return understand_samples(Samples.of(demonstrations), parameters, stages)


def understand_samples(samples: Samples, parameters: InferenceParameters, stages: Stages = UNSEEN) -> Understanding:
    """The same of a table of actions. Raises NothingLearnedError if nothing was moved."""
    moves, left_out = moves_of(samples, parameters)
    if moves.put_back.all():
        raise NothingLearnedError("no object was moved in any demonstration: everything was put back where it was")
    targets = stages.run("cluster", lambda: find_targets(moves, parameters))
    return stages.run("infer", lambda: _meant(moves, left_out, targets, parameters))


def _meant(
    moves: Moves, left_out: LeftOut, targets: Sequence[Target], parameters: InferenceParameters
) -> Understanding:
    """What the moves to these targets mean."""
    moves, left_out, targets = with_visits(moves, left_out, targets, parameters)
    chains = chains_of(moves, targets)
    if not chains.lengths.any() and moves.released.any():
        targets = [alone(int(n), moves, parameters) for n in np.flatnonzero(moves.released & ~moves.put_back)]
        chains = chains_of(moves, targets)
    groups = groups_of(moves.samples, chains, _held_at_end(moves), parameters)
    inside = np.zeros(len(moves), dtype=np.bool_)
    inside[[number for target in targets for number in target.members]] = True
    strange = tuple(np.flatnonzero(moves.released & ~inside).tolist())
    passed, fleeting = find_passed(left_out, parameters), _fleeting(np.array(strange, dtype=np.intp), moves, parameters)
    return Understanding(parameters, moves, tuple(targets), tuple(groups), strange, left_out, tuple(passed), fleeting)


def _fleeting(strange: Rows, moves: Moves, parameters: InferenceParameters) -> tuple[Target, ...]:
    names = moves.object[strange]
    return tuple(t for name in np.unique(names) for t in find_fleeting(strange[names == name], moves, parameters))


def _held_at_end(moves: Moves) -> Names:
    """What each demonstration (k,) ends with in the gripper; "" for nothing."""
    held = np.full(len(moves.samples.numbers), "", dtype=moves.object.dtype)
    held[moves.demonstration[~moves.released]] = moves.object[~moves.released]
    return held
