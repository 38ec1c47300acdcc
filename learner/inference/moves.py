"""Moves: a pick and the release that follows it, cleaned of what does not belong to the task."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Names, Samples
from learner.model.pose import Array
from learner.model.poses import Mask, Rows

NONE = -1
"""Stands for the release of a move that ends the demonstration with its pick."""
MOVED_AGAIN: Final = "was moved again at once; the last counts"
PUT_BACK: Final = "was put back; not part of the task"


@dataclass(frozen=True, eq=False)
class Moves:
    """Objects that were picked and released: m moves, by demonstration and in order.

    `pick` and `release` are places (m,) in `samples`; the release is NONE for a pick that ends the demonstration.
    `put_back` tells which (m,) were put down where they had been picked up. That is a mistake taken back, unless
    other demonstrations put the object there too, for whom it had to come from further away.
    """

    samples: Samples
    pick: Rows
    release: Rows
    put_back: Mask

    def __len__(self) -> int:
        return len(self.pick)

    @cached_property
    def object(self) -> Names:
        """What each moved (m,)."""
        return self.samples.object[self.pick]

    @cached_property
    def demonstration(self) -> Rows:
        """The number (m,) of the demonstration of each."""
        return self.samples.demonstration[self.pick]

    @property
    def released(self) -> Mask:
        """Which (m,) have a release."""
        return np.asarray(self.release != NONE)

    def select(self, which: Rows | Sequence[int]) -> Moves:
        """Some of the moves, of the same samples."""
        rows = np.asarray(which, dtype=np.intp)
        return Moves(self.samples, self.pick[rows], self.release[rows], self.put_back[rows])

    def picks(self, which: Rows | Mask) -> Samples:
        """The picks of some moves."""
        return self.samples[self.pick[which]]

    def releases(self, which: Rows | Mask | Sequence[int]) -> Samples:
        """The releases of some moves, all of which have one."""
        return self.samples[self.release[np.asarray(which)]]

    def name(self, number: int) -> str:
        """The id of the demonstration of a move."""
        return str(self.samples.demonstrations[self.demonstration[number]].demonstration_id)

    def last_step(self, number: int) -> int:
        """The number in its demonstration of the last action of a move."""
        row = self.pick[number] if self.release[number] == NONE else self.release[number]
        return int(self.samples.step[row])


@dataclass(frozen=True)
class LeftOut:
    """Moves that do not count, by demonstration and in order, each for a reason: a sentence's end."""

    moves: Moves
    reasons: tuple[str, ...]

    @property
    def corrected(self) -> Rows:
        """The numbers of those that the next move of the same demonstration took further."""
        return np.flatnonzero(np.array(self.reasons, dtype=np.str_) == MOVED_AGAIN)

    def sentence(self, number: int) -> str:
        """A note on one of them."""
        moves = self.moves
        where = f"demonstration {moves.name(number)}, action {moves.samples.step[moves.pick[number]]}"
        return f"{where}: {moves.object[number]} {self.reasons[number]}"


def moves_of(samples: Samples, parameters: InferenceParameters) -> tuple[Moves, LeftOut]:
    """The moves of all actions of some demonstrations, and those that were left out.

    Left out are what the very next move corrects, and what was put back to where this demonstration had put it before.
    """
    pairs = _pairs(samples)
    moved_m = _displacements_m(pairs, pairs.pick)
    left_alone = moved_m < parameters.left_alone_m
    kept = np.ones(len(pairs), dtype=np.bool_)
    left_out: dict[int, str] = {}
    for numbers in _repeating(pairs):
        kept[numbers] = False
        kept[_cleaned(numbers, pairs, left_alone, left_out)] = True
    altogether_m = _displacements_m(pairs, _first_picks(pairs, left_out))
    put_back = np.maximum(moved_m, altogether_m) < parameters.put_back_m
    everything = Moves(samples, pairs.pick, pairs.release, put_back)
    others = sorted(left_out)
    return everything.select(np.flatnonzero(kept)), LeftOut(
        everything.select(others), tuple(left_out[n] for n in others)
    )


def _pairs(samples: Samples) -> Moves:
    """Picks with their releases, in order. An observation guarantees that they alternate."""
    picks = np.flatnonzero(samples.type == "pick")
    following = np.minimum(picks + 1, len(samples) - 1)
    paired = (picks + 1 < len(samples)) & (samples.demonstration[following] == samples.demonstration[picks])
    return Moves(samples, picks, np.where(paired, following, NONE), np.zeros(len(picks), dtype=np.bool_))


def _first_picks(pairs: Moves, left_out: Mapping[int, str]) -> Rows:
    """The pick of each move (m,); of one that corrects another, the pick of that one."""
    picks = pairs.pick.copy()
    for number, reason in sorted(left_out.items()):
        if reason == MOVED_AGAIN:
            picks[number + 1] = picks[number]
    return picks


def _displacements_m(pairs: Moves, picks: Rows) -> Array:
    """How far each object came in the base [m] from where it was at its pick to where it rests; inf if it is held."""
    samples, base = pairs.samples, pairs.samples.base
    before = samples.release(base).positions[picks]
    after = samples.rest(base).positions[pairs.release]
    moved_m = np.linalg.norm(after - before, axis=1)
    return np.where(pairs.released & samples.rest_known[pairs.release], moved_m, np.inf)


def _repeating(moves: Moves) -> Iterator[list[int]]:
    """The numbers of the moves of each demonstration that moves an object more than once."""
    names, of = np.unique(moves.object, return_inverse=True)
    pairs, times = np.unique(moves.demonstration * len(names) + of.reshape(-1), return_counts=True)
    some = np.unique(pairs[times > 1] // max(len(names), 1))
    begins = np.searchsorted(moves.demonstration, some)
    ends = np.searchsorted(moves.demonstration, some, side="right")
    return (list(range(begin, end)) for begin, end in zip(begins.tolist(), ends.tolist(), strict=True))


def _cleaned(numbers: Sequence[int], moves: Moves, left_alone: Mask, left_out: dict[int, str]) -> list[int]:
    """Those moves of one demonstration that are kept; the others join `left_out` with their reasons."""
    names = moves.object[numbers].tolist()
    kept: list[int] = []
    for number, name in zip(numbers, names, strict=True):
        if left_alone[number] and any(moves.object[earlier] == name for earlier in kept):
            left_out[number] = PUT_BACK
            continue
        if kept and moves.object[kept[-1]] == name and moves.release[kept[-1]] != NONE:
            left_out[kept.pop()] = MOVED_AGAIN
        kept.append(number)
    return kept
