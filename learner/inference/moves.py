"""Moves: a pick and the release that follows it, cleaned of what does not belong to the task."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Sample
from learner.model import DemonstratedAction, Demonstration


@dataclass(frozen=True)
class Move:
    """One object, picked and released; `release` is None for a pick that ends the demonstration.

    `put_back`: it was put down where it had been picked up. That is a mistake taken back, unless other demonstrations
    put it there too, for whom it had to come from further away.
    """

    demonstration: int
    pick: DemonstratedAction
    release: DemonstratedAction | None
    put_back: bool = False

    @property
    def object(self) -> str:
        return self.pick.object


def moves_of(
    number: int, demonstration: Demonstration, parameters: InferenceParameters
) -> tuple[list[Move], list[str]]:
    """The moves of one demonstration, and a note on each that was left out.

    Left out are what the very next move corrects, and what was put back to where this demonstration had put it before.
    """
    kept: list[Move] = []
    notes: list[str] = []
    for pair in _pairs(number, demonstration):
        moved_m = _displacement_m(demonstration, pair)
        move = replace(pair, put_back=moved_m < parameters.put_back_m)
        if moved_m < parameters.left_alone_m and any(earlier.object == move.object for earlier in kept):
            notes.append(f"{_where(demonstration, move)}: {move.object} was put back; not part of the task")
            continue
        if kept and kept[-1].object == move.object and kept[-1].release is not None:
            notes.append(f"{_where(demonstration, kept[-1])}: {move.object} was moved again at once; the last counts")
            kept.pop()
        kept.append(move)
    return kept, notes


def _pairs(number: int, demonstration: Demonstration) -> list[Move]:
    """Picks with their releases, in order. An observation guarantees that they alternate."""
    actions = list(demonstration.actions)
    pairs = []
    for index in range(0, len(actions), 2):
        release = actions[index + 1] if index + 1 < len(actions) else None
        pairs.append(Move(number, actions[index], release))
    return pairs


def _displacement_m(demonstration: Demonstration, move: Move) -> float:
    """How far the object came in the base [m] from where it was picked up to where it rests; inf if it is held."""
    if move.release is None or move.release.rest is None:
        return math.inf
    before = move.pick.objects[move.object].position
    after = move.release.rest[demonstration.base_frame].position
    return float(np.linalg.norm(np.subtract(after, before)))


def _where(demonstration: Demonstration, move: Move) -> str:
    return f"demonstration {demonstration.demonstration_id}, action {move.pick.step}"


def release_sample(demonstrations: Sequence[Demonstration], move: Move) -> Sample:
    """The release of a move as a sample."""
    assert move.release is not None
    demonstration = demonstrations[move.demonstration]
    return Sample(move.demonstration, demonstration.user, demonstration.base_frame, move.release)
