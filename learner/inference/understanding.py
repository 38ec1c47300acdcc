"""What the demonstrations mean: moves, targets, and groups with one goal each, before any tree is built."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from learner.errors import NothingLearnedError
from learner.inference.goals import Group, groups_of
from learner.inference.moves import Move, moves_of
from learner.inference.parameters import InferenceParameters
from learner.inference.targets import Target, TargetFinder
from learner.model import Demonstration

Meaning = frozenset[frozenset[tuple[str, str, str]]]
"""The goals of all groups, each as (object, type, frame) of its targets; of frames that are rigid by the task the
first by name, since any of them means the same."""


@dataclass(frozen=True)
class Understanding:
    """What was understood of `demonstrations` with these `parameters`.

    `strange` are the numbers of moves that belong to no target.
    """

    demonstrations: tuple[Demonstration, ...]
    parameters: InferenceParameters
    moves: tuple[Move, ...]
    targets: tuple[Target, ...]
    groups: tuple[Group, ...]
    strange: tuple[int, ...]
    notes: tuple[str, ...]

    @property
    def meaning(self) -> Meaning:
        return frozenset(
            frozenset((t.object, t.verdict.type, min(t.tied | {t.frame})) for t in group.goal) for group in self.groups
        )


def understand(demonstrations: Sequence[Demonstration], parameters: InferenceParameters) -> Understanding:
    """Moves cleaned, targets found, goals grouped. Raises NothingLearnedError if nothing was moved."""
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
    held = {move.demonstration: move.object for move in moves if move.release is None}
    pursued = {number: chain for number, chain in chains.items() if chain or number in held}
    groups = groups_of(demonstrations, pursued, held, parameters)
    inside = {number for target in targets for number in target.members}
    strange = tuple(n for n, move in enumerate(moves) if move.release is not None and n not in inside)
    return Understanding(
        tuple(demonstrations), parameters, tuple(moves), tuple(targets), tuple(groups), strange, tuple(notes)
    )  # fmt: skip


def _chains(count: int, moves: Sequence[Move], targets: Sequence[Target]) -> dict[int, list[Target]]:
    """For each demonstration the targets it reached, in order."""
    of = {number: target for target in targets for number in target.members}
    chains: dict[int, list[Target]] = {number: [] for number in range(count)}
    for number, move in enumerate(moves):
        if number in of:
            chains[move.demonstration].append(of[number])
    return chains
