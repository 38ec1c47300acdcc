"""Visits: places on the way (a station, a stamp) that most demonstrations bring an object to before its target.

What the very next move takes further is left out as corrected. Where a majority does so alike, and not only to set the
object down a little better, it is a step of the task.
"""

from __future__ import annotations

from bisect import bisect
from collections import defaultdict
from collections.abc import Container, Iterator, Sequence
from dataclasses import replace

import numpy as np

from learner.inference.finding import find_passed, with_ties
from learner.inference.goals import began_at
from learner.inference.moves import LeftOut, Moves
from learner.inference.parameters import InferenceParameters
from learner.inference.targets import Target
from learner.inference.ties import anchors_of
from learner.model.condition import DROP_RADIUS_M, PLACE_RADIUS_M
from learner.model.poses import Rows


def with_visits(
    moves: Moves, left_out: LeftOut, targets: Sequence[Target], parameters: InferenceParameters
) -> tuple[Moves, LeftOut, list[Target]]:
    """The moves that count, those left out, and the targets, with the places that a majority visits."""
    visited = list(_visited(moves, left_out, targets, parameters))
    if not visited:
        return moves, left_out, list(targets)
    of = np.array(sorted({number for target in visited for number in target.members}), dtype=np.intp)
    both = _joined(moves, left_out.moves.select(of))
    found = [_numbered(target, moves, both) for target in targets]
    visits = [_numbered(target, left_out.moves, both) for target in visited]
    anchors = anchors_of(both, [*found, *visits])
    others = np.setdiff1d(np.arange(len(left_out.moves)), of)
    rest = LeftOut(left_out.moves.select(others), tuple(left_out.reasons[number] for number in others))
    found += [with_ties(target, anchors, both, parameters) for target in visits]
    return both, rest, sorted(found, key=lambda t: (t.object, float(np.mean(both.releases(t.members).step))))


def is_correction(target: Target, moves: Moves, left_out: LeftOut, parameters: InferenceParameters) -> bool:
    """Whether a place that was passed is near where most brought the object in the end: set down badly, and put right.

    Its members are moves left out.
    """
    ahead = {number: other for number, other in _ahead(target, moves, left_out).items() if moves.released[other]}
    if not ahead:
        return False
    passed, ends = left_out.moves.releases(list(ahead)), moves.releases(list(ahead.values()))
    base = moves.samples.base
    away_m = np.linalg.norm(ends.rest(base).positions - passed.rest(base).positions, axis=1)
    near_m = np.where(ends.type == "drop", DROP_RADIUS_M, PLACE_RADIUS_M)
    return bool(2 * (away_m < near_m).sum() > len(ahead))


def _visited(
    moves: Moves, left_out: LeftOut, targets: Sequence[Target], parameters: InferenceParameters
) -> Iterator[Target]:
    """The places passed that most demonstrations visit on the way to a target, where the object did not begin."""
    ends = {number: target for target in targets for number in target.members}
    for passed in find_passed(left_out, parameters):
        onward = {number: ends[other] for number, other in _ahead(passed, moves, left_out).items() if other in ends}
        shown = np.unique(left_out.moves.demonstration[list(onward)])
        home = any(began_at(end, shown, moves.samples, parameters.same_goal_m) for end in set(onward.values()))
        most = 2 * len(shown) > len(moves.samples.numbers)
        if most and not home and not is_correction(passed, moves, left_out, parameters):
            yield _among(passed, onward)


def _among(target: Target, numbers: Container[int]) -> Target:
    """The target with only some of its members."""
    kept = np.array([number in numbers for number in target.members])
    members = tuple(number for number in target.members if number in numbers)
    return replace(target, members=members, rests=target.rests[kept], releases=target.releases[kept])


def _ahead(target: Target, moves: Moves, left_out: LeftOut) -> dict[int, int]:
    """For each move left out, where it has one, the number of the move that counts and took the object further."""
    later: dict[tuple[int, str], list[int]] = defaultdict(list)
    for number, key in enumerate(zip(moves.demonstration.tolist(), moves.object.tolist(), strict=True)):
        later[key].append(number)
    found = {}
    for number in target.members:
        numbers = later[int(left_out.moves.demonstration[number]), target.object]
        place = bisect(moves.pick[numbers].tolist(), int(left_out.moves.pick[number]))
        found.update({number: numbers[place]} if place < len(numbers) else {})
    return found


def _joined(some: Moves, others: Moves) -> Moves:
    """All of them, in order."""
    pick, release, put_back = (
        np.concatenate([getattr(each, name) for each in (some, others)]) for name in ("pick", "release", "put_back")
    )
    order = np.argsort(pick)
    return Moves(some.samples, pick[order], release[order], put_back[order])


def _numbered(target: Target, moves: Moves, among: Moves) -> Target:
    """A target with its members numbered as among other moves."""
    members: Rows = np.searchsorted(among.pick, moves.pick[list(target.members)])
    return replace(target, members=tuple(members.tolist()))
