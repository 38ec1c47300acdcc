"""Equal parts: what the demonstrations do with any of a kind, and the tree only with those that it knows by name."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence, Set
from itertools import combinations
from typing import Final

import numpy as np

from learner.inference.targets import Target
from learner.inference.understanding import Understanding
from learner.model import ObjectShape, Scene
from learner.model.doubt import Doubt
from learner.regularities.parameters import RegularityParameters
from learner.regularities.told import doubt, is_regular, listed, share

WHAT: Final = "kind"


def kinds(understood: Understanding, scene: Scene | None, parameters: RegularityParameters) -> Iterator[Doubt]:
    """A doubt for each kind whose members are treated alike, and for equal parts put into each other's places."""
    told = set[str]()
    for kind, members in sorted(_by_kind(scene).items()):
        moved = _moved(members, understood)
        if len(moved) > 1 and _are_treated_alike(list(moved), understood):
            told |= set(moved)
            yield _of_a_kind(kind, moved, understood)
    names, numbers = _interchanged(understood, scene)
    if not names <= told and is_regular(numbers, parameters.few, understood, parameters):
        yield _of_equals(sorted(names), numbers, understood)


def _of_equals(names: Sequence[str], numbers: Set[int], understood: Understanding) -> Doubt:
    sentence = (
        f"{listed(names)}, which look alike, were put into each other's places "
        f"{share(len(numbers), len(understood.demonstrations))}; the tree keeps each to its own; if any of them will "
        f"do, give them one kind in the scene, else show once more which goes where"
    )
    return doubt(understood, numbers, names[0], WHAT, sentence)


def _by_kind(scene: Scene | None) -> Mapping[str, list[str]]:
    found: dict[str, list[str]] = defaultdict(list)
    for name, shape in sorted(scene.objects.items()) if scene else ():
        if shape.kind is not None:
            found[shape.kind].append(name)
    return found


def _moved(names: Sequence[str], understood: Understanding) -> Mapping[str, set[int]]:
    """Those of some objects that are brought somewhere, and in which demonstrations."""
    moves = understood.moves
    brought = moves.released & ~moves.put_back
    shown = {name: set(moves.demonstration[brought & (moves.object == name)].tolist()) for name in names}
    return {name: numbers for name, numbers in shown.items() if numbers}


def _are_treated_alike(names: Sequence[str], understood: Understanding) -> bool:
    """Whether several are dropped into one thing, not all are moved each time, or one is put where another was."""
    targets = [target for target in understood.targets if target.supported and target.object in names]
    into = [target.frame for target in targets if target.type == "drop"]
    each_time = all(numbers >= _shown(understood) for numbers in _moved(names, understood).values())
    exchanged, _ = _interchanged(understood, None, names)
    return len(into) > len(set(into)) or not each_time or len(exchanged) > 1


def _shown(understood: Understanding) -> set[int]:
    return set(understood.moves.demonstration.tolist())


def _of_a_kind(kind: str, moved: Mapping[str, set[int]], understood: Understanding) -> Doubt:
    numbers = set[int]().union(*moved.values())
    return doubt(
        understood, numbers, min(moved), WHAT,
        f"{listed(sorted(moved))} are all of kind {kind} and were treated alike "
        f"{share(len(numbers), len(understood.demonstrations))}; the tree knows them by name, and does nothing with "
        f"another {kind}; to check that this will do, show it once with another {kind} there",
    )  # fmt: skip


def _interchanged(
    understood: Understanding, scene: Scene | None, among: Sequence[str] | None = None
) -> tuple[set[str], set[int]]:
    """Equal objects of which one is put where others put another, and the numbers of the demonstrations that do so."""
    names, numbers = set[str](), set[int]()
    targets = [target for target in understood.targets if target.supported]
    for target in targets:
        for number in _strange_at(target, understood):
            name = str(understood.moves.object[number])
            if _alike(name, target.object, scene, among):
                names |= {name, target.object}
                numbers.add(int(understood.moves.demonstration[number]))
    for one, other in combinations(targets, 2):
        shown, also = _demonstrations(one, understood), _demonstrations(other, understood)
        if _alike(one.object, other.object, scene, among) and not shown & also and _is_one(one, other, understood):
            names |= {one.object, other.object}
            numbers |= shown | also
    return names, numbers


def _demonstrations(target: Target, understood: Understanding) -> set[int]:
    return set(understood.moves.demonstration[list(target.members)].tolist())


def _strange_at(target: Target, understood: Understanding) -> list[int]:
    """The moves that no target explains, and that end where a target of another object is that is not brought there."""
    moves, strange = understood.moves, np.array(understood.strange, dtype=np.intp)
    free = ~np.isin(moves.demonstration[strange], list(_demonstrations(target, understood)))
    others = strange[free & ~moves.put_back[strange] & (moves.object[strange] != target.object)]
    if not len(others):
        return []
    away = moves.releases(others).rest(target.frame).positions - target.rests.positions.mean(axis=0)
    return list(others[np.linalg.norm(away, axis=1) < understood.parameters.tight_m].tolist())


def _alike(one: str, other: str, scene: Scene | None, among: Sequence[str] | None) -> bool:
    """Whether two objects are different ones of the same body, or, where it is told which, among those."""
    if one == other or among is not None:
        return one != other and among is not None and {one, other} <= set(among)
    known: Mapping[str, ObjectShape] = scene.objects if scene else {}
    return one in known and other in known and known[one].body == known[other].body


def _is_one(one: Target, other: Target, understood: Understanding) -> bool:
    """Whether two targets are one place of one frame."""
    away = one.rests.positions.mean(axis=0) - other.rests.positions.mean(axis=0)
    return one.frame == other.frame and bool(np.linalg.norm(away) < understood.parameters.tight_m)
