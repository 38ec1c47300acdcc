"""How a regularity is told: in which demonstrations, and how many that are."""

from __future__ import annotations

from collections.abc import Iterable

from learner.inference.understanding import Understanding
from learner.model.doubt import Doubt


def doubt(understood: Understanding, numbers: Iterable[int], name: str | None, what: str, sentence: str) -> Doubt:
    """A doubt about some of the demonstrations, by their numbers."""
    ids = tuple(understood.demonstrations[number].demonstration_id for number in sorted(set(numbers)))
    return Doubt(ids, name, what, sentence)


def share(count: int, of: int) -> str:
    """`in each of 3 demonstrations`, `in 4 of 5 demonstrations`."""
    if count < of:
        return f"in {count} of {of} demonstrations"
    return f"in each of {of} demonstrations" if of > 1 else "in the demonstration"
