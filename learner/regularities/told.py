"""What is regular, and how it is told: in which demonstrations, and how many that are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from learner.inference.understanding import Understanding
from learner.model.doubt import Doubt
from learner.regularities.parameters import RegularityParameters


def counted(understood: Understanding) -> set[int]:
    """The demonstrations whose goal counts: a few that mean another task tell nothing of this one."""
    everyone = set(range(len(understood.demonstrations)))
    inside = {number for group in understood.groups for number in group.demonstrations}
    return inside if 2 * len(inside) > len(everyone) else everyone


def is_regular(
    numbers: Iterable[int], share: float, understood: Understanding, parameters: RegularityParameters
) -> bool:
    """Whether more than a share of the demonstrations that count are among these, of as many users as make a cluster.

    The share is of all that count; of several users one alone may have a habit.
    """
    everyone = counted(understood)
    shown = sorted(everyone & set(numbers))
    users = understood.samples.users
    enough = understood.parameters.users_for(len(np.unique(users)))
    many = len(shown) >= parameters.least and len(shown) > share * len(everyone)
    return many and len(np.unique(users[shown])) >= enough


def doubt(understood: Understanding, numbers: Iterable[int], name: str | None, what: str, sentence: str) -> Doubt:
    """A doubt about some of the demonstrations, by their numbers."""
    ids = tuple(understood.demonstrations[number].demonstration_id for number in sorted(set(numbers)))
    return Doubt(ids, name, what, sentence)


def listed(names: Sequence[str]) -> str:
    """`A`, `A and B`, `A, B and C`."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def share(count: int, of: int) -> str:
    """`in each of 3 demonstrations`, `in 4 of 5 demonstrations`."""
    if count < of:
        return f"in {count} of {of} demonstrations"
    return f"in each of {of} demonstrations" if of > 1 else "in the demonstration"
