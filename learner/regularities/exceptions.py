"""Exceptions: moves that no target explains, few of each object, but in many demonstrations or a third of them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from learner.inference.understanding import Understanding
from learner.model.doubt import Doubt
from learner.regularities.parameters import RegularityParameters
from learner.regularities.told import doubt, is_regular, listed, share

WHAT: Final = "place"
By = Mapping[str, set[int]]
"""The numbers of demonstrations by object."""


def exceptions(understood: Understanding, told: Sequence[Doubt], parameters: RegularityParameters) -> Iterator[Doubt]:
    """A doubt for each object that some demonstrations put elsewhere, where more than a few put something elsewhere."""
    found = _untold(understood, told)
    everyone = set[int]().union(*found.values())
    if is_regular(everyone, parameters.few, understood, parameters):
        for name, numbers in found.items():
            yield doubt(
                understood, numbers, name, WHAT,
                f"{name} was put where others do not put it {share(len(numbers), len(understood.demonstrations))}, and "
                f"{listed(sorted(found))} {share(len(everyone), len(understood.demonstrations))}: that is a rule that "
                f"the tree does not know; to find it out, show it twice from one and the same start",
            )  # fmt: skip


def questions_on(
    understood: Understanding, told: Sequence[Doubt], parameters: RegularityParameters
) -> list[dict[str, Any]]:
    """A question for each object that some put elsewhere, where more than a few put something so: is it an error?"""
    found = _untold(understood, told)
    if len(set[int]().union(*found.values())) < parameters.asked * len(understood.demonstrations):
        return []
    return [_question(name, sorted(numbers), understood) for name, numbers in found.items()]


def _question(name: str, numbers: Sequence[int], understood: Understanding) -> dict[str, Any]:
    ids = [understood.demonstrations[number].demonstration_id for number in numbers]
    show = f"show it once more from a start as in {ids[0]}"
    sentence = (
        f"{name} was put elsewhere in {listed(ids)} than in the other demonstrations; if that was no mistake, {show}, "
        f"else leave {'it' if len(ids) == 1 else 'them'} out (`treewright demos exclude {ids[0]}`)"
    )
    return {"action": f"move {name}", "frame": understood.samples.base, "rival": None, "certainty": None,
            "show": show, "sentence": sentence}  # fmt: skip


def _untold(understood: Understanding, told: Sequence[Doubt]) -> By:
    """The demonstrations by object whose moves no target explains, and no doubt tells."""
    moves, found = understood.moves, defaultdict[str, set[int]](set)
    known = {(identifier, each.object) for each in told for identifier in each.demonstrations}
    explained = {number for target in understood.fleeting for number in target.members}
    for number in set(understood.strange) - explained:
        if not moves.put_back[number] and (moves.name(number), str(moves.object[number])) not in known:
            found[str(moves.object[number])].add(int(moves.demonstration[number]))
    return dict(sorted(found.items()))
