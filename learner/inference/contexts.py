"""Contexts: which time it is that a demonstration brings an object to a place, where it does so several times."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from learner.inference.moves import Moves
from learner.model.pose import Array

Members = tuple[int, ...]
Enough = Callable[[Sequence[int]], bool]
"""Whether enough demonstrations and users share some moves."""


def by_time(members: Sequence[int], moves: Moves, enough: Enough) -> list[Members]:
    """Moves to one place by which time it is that they reach it: as many times as enough demonstrations share.

    One that reaches it fewer times (or more) is matched by how far it had come then, as those usually had.
    """
    numbers = np.sort(np.array(members, dtype=np.intp))
    if len(np.unique(moves.demonstration[numbers])) == len(numbers):
        return [tuple(numbers.tolist())]
    turns: dict[int, list[int]] = defaultdict(list)
    for demonstration, number in zip(moves.demonstration[numbers].tolist(), numbers.tolist(), strict=True):
        turns[demonstration].append(number)
    longest = max(map(len, turns.values()))
    times = max((k for k in range(1, 1 + longest) if _shared(turns, k, enough)), default=1)
    progress = dict(zip(numbers.tolist(), moves.releases(numbers).progress.tolist(), strict=True))
    usual = [[progress[number] for number in turn] for turn in turns.values() if len(turn) == times]
    when = np.mean(usual or [[0.0] * times], axis=0)
    matched = [_matched(turn, progress, when) for turn in turns.values()]
    return [tuple(turn[k] for turn in matched if k in turn) for k in range(times)]


def _shared(turns: Mapping[int, Sequence[int]], times: int, enough: Enough) -> bool:
    return enough([turn[times - 1] for turn in turns.values() if len(turn) >= times])


def _matched(turn: Sequence[int], progress: Mapping[int, float], when: Array) -> dict[int, int]:
    """Which move of one demonstration belongs to which time, in order, as near as can be to `when` (times,)."""
    if len(turn) == len(when):
        return dict(enumerate(turn))
    from scipy.optimize import linear_sum_assignment

    done = np.array([progress[number] for number in turn])
    times, chosen = linear_sum_assignment(np.abs(np.subtract.outer(np.array(when), done)))
    return {int(k): turn[int(n)] for k, n in zip(sorted(times), sorted(chosen), strict=True)}
