"""Chains: the targets that each demonstration reaches, in order; and the order that they have in common."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from learner.inference.moves import Moves
from learner.inference.targets import Target
from learner.model.poses import Rows

Chain = tuple[Target, ...]
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, eq=False)
class Chains:
    """The `distinct` chains of some demonstrations, and `of` (k,) which of them each shows."""

    distinct: tuple[Chain, ...]
    of: Rows

    @property
    def lengths(self) -> Rows:
        """How many targets each demonstration reaches (k,)."""
        return np.array([len(chain) for chain in self.distinct], dtype=np.intp)[self.of]

    def select(self, which: Rows) -> Chains:
        """The chains of some of the demonstrations."""
        kept, of = np.unique(self.of[which], return_inverse=True)
        return Chains(tuple(self.distinct[number] for number in kept), of.reshape(-1))

    def counts(self) -> dict[Target, int]:
        """How many demonstrations reach each target."""
        times = np.bincount(self.of, minlength=len(self.distinct)).tolist()
        counts: Counter[Target] = Counter()
        for chain, count in zip(self.distinct, times, strict=True):
            counts.update(dict.fromkeys(chain, count))
        return dict(counts)


def chains_of(moves: Moves, targets: Sequence[Target]) -> Chains:
    """What each demonstration reaches with these moves."""
    target = np.full(len(moves), -1)
    for number, each in enumerate(targets):
        target[list(each.members)] = number
    reached = np.flatnonzero(target >= 0)
    demonstrations = moves.demonstration[reached]
    count = len(moves.samples.numbers)
    lengths = np.bincount(demonstrations, minlength=count)
    table = np.full((count, int(lengths.max(initial=0))), -1)
    place = np.arange(len(reached)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    table[demonstrations, place] = target[reached]
    rows, of = np.unique(table, axis=0, return_inverse=True)
    return Chains(tuple(tuple(targets[n] for n in row if n >= 0) for row in rows.tolist()), of.reshape(-1))


def orders(sequences: Collection[Sequence[Key]]) -> set[tuple[Key, Key]]:
    """Every pair (a, b) with a seen before b in some sequence and never after it."""
    seen = {
        (a, b)
        for sequence in sequences
        for place, a in enumerate(sequence)
        for b in sequence[place + 1 :]
        if a != b
    }  # fmt: skip
    return {(a, b) for a, b in seen if (b, a) not in seen}


def ordered(targets: Sequence[Target], chains: Chains) -> list[Target]:
    """The targets in an order that no demonstration contradicts where they agree; else by when they were reached."""
    before = orders(chains.distinct)
    ranks = {target: _rank(target, chains) for target in targets}
    left, result = sorted(targets, key=lambda target: ranks[target]), []
    while left:
        free = [t for t in left if not any((other, t) in before for other in left)]
        result.append((free or left)[0])
        left.remove(result[-1])
    return result


def _rank(target: Target, chains: Chains) -> tuple[float, str, tuple[int, ...]]:
    """When a target is reached on average, from 0 to 1; 0 for one that no demonstration reaches."""
    places = [[(n + 0.5) / len(chain) for n, other in enumerate(chain) if other == target] for chain in chains.distinct]
    shown = [place for number in chains.of.tolist() for place in places[number]]
    return (float(np.mean(shown)) if shown else 0.0, target.object, target.members)
