"""Task constraints and goals, as the paper infers them (section III-D)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from learner.inference.chains import Key, orders
from learner.model import Action, Condition, InGripper, ObjectAt, ObjectRoughlyAt, compatible
from learner.model.names import NONE


def guards(
    key: Key, actions: Mapping[Key, Action], sequences: Collection[Sequence[Key]]
) -> tuple[Condition, ...]:  # fmt: skip
    """The conditions that the demonstrated order makes preconditions of the action `key`, the oldest first.

    Those are the positions that earlier actions achieved, unless they are incompatible with the action's own
    conditions; of two that conflict, the one closer to the action wins, in whichever demonstration it came closest, and
    of two as close the one demonstrated first.
    What the gripper holds is left out: it lasts only until the next action, whose own preconditions say it.
    """
    own = actions[key].preconditions | actions[key].postconditions
    distances = _distances(key, actions, sequences)
    found: list[Condition] = []
    for condition in sorted(distances, key=lambda condition: distances[condition]):
        if all(compatible(condition, other) for other in (*own, *found)):
            found.append(condition)
    ranks = {c: _rank(c, actions, sequences) for c in found}
    return tuple(sorted(found, key=lambda condition: (ranks[condition], repr(condition))))


def _distances(
    key: Key, actions: Mapping[Key, Action], sequences: Collection[Sequence[Key]]
) -> dict[Condition, int]:  # fmt: skip
    """The positions achieved before the action `key` in every demonstration that shows both, and how many actions
    before it at the least."""
    before = {a for a, b in orders(sequences) if b == key}
    found: dict[Condition, int] = {}
    for sequence in sequences:
        place = list(sequence).index(key) if key in sequence else 0
        for distance, earlier in enumerate(reversed(sequence[:place]), start=1):
            for condition in _positions(actions[earlier]) if earlier in before else ():
                found[condition] = min(distance, found.get(condition, distance))
    return found


def goals(sequence: Sequence[Key], actions: Mapping[Key, Action]) -> tuple[Condition, ...]:
    """The goal of one demonstration: post-conditions gathered from its end backwards while compatible.

    In the order in which they were achieved; the gripper's come last, with a held object before the closed gripper:
    the gripper has to open before it can hold something.
    """
    found: dict[Condition, None] = {}
    for key in reversed(sequence):
        for condition in sorted(actions[key].postconditions, key=repr):
            if all(compatible(condition, other) for other in found):
                found[condition] = None
    positions = [condition for condition in found if isinstance(condition, ObjectAt | ObjectRoughlyAt)]
    rest = sorted((c for c in found if c not in positions), key=lambda c: not _holds_something(c))
    return (*reversed(positions), *rest)


def _holds_something(condition: Condition) -> bool:
    return isinstance(condition, InGripper) and condition.object != NONE


def _positions(action: Action) -> list[Condition]:
    return [condition for condition in action.postconditions if isinstance(condition, ObjectAt | ObjectRoughlyAt)]


def _rank(condition: Condition, actions: Mapping[Key, Action], sequences: Collection[Sequence[Key]]) -> float:
    """How early in the demonstrations a condition was achieved, on average."""
    places = [
        place / len(sequence)
        for sequence in sequences
        for place, key in enumerate(sequence)
        if condition in actions[key].postconditions
    ]
    return sum(places) / len(places)
