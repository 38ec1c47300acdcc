"""Several goals: what differed at the start where one or the other was pursued.

The tree takes any goal that is reached for done and pursues the first that it can (paper, section III-D). Where the
starts tell the demonstrations of one goal from those of another, that is more than the tree knows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Final

import numpy as np

from learner.inference.goals import Group
from learner.inference.samples import Samples
from learner.inference.understanding import Understanding
from learner.model.doubt import Doubt
from learner.model.pose import Array
from learner.regularities.parameters import RegularityParameters
from learner.regularities.told import doubt

WHAT: Final = "goal"


def choices(understood: Understanding, parameters: RegularityParameters) -> Iterator[Doubt]:
    """A doubt for each two goals that what was seen at the start tells apart."""
    for one, other in combinations(understood.groups, 2):
        if told := _difference(one, other, understood.samples, parameters):
            numbers = (*one.demonstrations, *other.demonstrations)
            yield doubt(understood, numbers, None, WHAT, _sentence(one, other, told))


def _difference(one: Group, other: Group, samples: Samples, parameters: RegularityParameters) -> str | None:
    """What was other at every start of one group than at every start of another, if that is hardly by chance."""
    first, second = list(one.demonstrations), list(other.demonstrations)
    features = dict(_features(samples, first + second))
    apart = [name for name, values in features.items() if _separated(values[: len(first)], values[len(first) :])]
    by_chance = 2 * _telling(features) / math.comb(len(first) + len(second), len(first))
    return apart[0] if apart and by_chance < parameters.chance else None


def _features(samples: Samples, numbers: list[int]) -> Iterator[tuple[str, Array]]:
    """What is told of the starts of some demonstrations: by name, a number for each (NaN where it is not known)."""
    for name in sorted(samples.columns.begins):
        poses = samples.begins(name)[np.array(numbers)]
        yield f"whether {name} was there", poses.known.astype(float)
        yield f"how far ahead {name} stood", poses.positions[:, 0]
        yield f"how far to the left {name} stood", poses.positions[:, 1]


def _telling(features: Mapping[str, Array]) -> int:
    """How many features differ between starts at all: the others cannot tell anything apart, not even by chance."""
    return sum(bool(np.ptp(values) > 0) for values in features.values())


def _separated(ones: Array, others: Array) -> bool:
    """Whether all of one are less than all of the others; never where one is not known."""
    return bool(ones.max() < others.min() or others.max() < ones.min())


def _sentence(one: Group, other: Group, what: str) -> str:
    first, second = (_goal(group) for group in (one, other))
    return (
        f"there are two goals, {first} and {second}, and {what} at the start tells which was pursued; the tree pursues "
        f"the first that it can; to check it, show both once more from starts that differ in nothing else"
    )


def _goal(group: Group) -> str:
    return " and ".join(f"{subgoal.target.object} at {subgoal.target.frame}" for subgoal in group.subgoals) or "none"
