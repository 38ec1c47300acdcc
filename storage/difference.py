"""What changed between two trees, in words: goals, order, frames, poses in millimetres, tolerances.

Compared is what the trees do when nothing is disturbed, leaf by leaf: a place, a release or a grasp of the old tree
goes with that of the new one for the same object which is nearest to it. What only recovers is told as one change.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from learner.model.pose import angle_between
from learner.model.tree import Node, Tree
from learner.model.vocabulary import LEAVES, RECOVERY_PREFIX

PLACES: Final = ("ObjectAt", "ObjectPosedAt", "ObjectRoughlyAt")
RELEASES: Final = ("Place", "Drop")
GRASPS: Final = ("Pick",)
HANDLING: Final = ("GripperIs", "InGripper", "SetGripper")
"""What every tree says of the gripper; it follows from the rest."""
NEAR_M: Final = 0.05
"""Places of one object this near to each other are told apart by their order, not by their distance."""
SHOWN: Final = 8
"""How many names one sentence lists."""

Pair = tuple[Node, Node]


@dataclass(frozen=True)
class Change:
    """One thing that changed, of `what` kind, about an object where it is about one, with its values then and now.

    `what` is 'goal', 'order', 'label' (place or drop), 'frame', 'pose', 'tolerance', 'recovery' or 'structure'.
    """

    what: str
    object: str | None
    sentence: str
    before: Any = None
    after: Any = None

    def to_data(self) -> dict[str, Any]:
        """As JSON-able data."""
        return asdict(self)


def differences(old: Tree, new: Tree) -> tuple[Change, ...]:
    """What changed from `old` to `new`; nothing for equal trees, and at least one change for others."""
    if old == new:
        return ()
    leaves = _leaves(old), _leaves(new)
    places, releases, grasps = (_Matched.of(kinds, *leaves) for kinds in (PLACES, RELEASES, GRASPS))
    goals = [*_goals(places), *_others(*leaves)]
    order = list(_order(releases))
    changes = [*goals, *order]
    changes += _together([*_frames(places), *_frames(releases), *_frames(grasps)])
    changes += [change for pair in places.pairs for change in _of_place(*pair)]
    changes += [change for pair in releases.pairs for change in _of_release(*pair)]
    changes += [change for pair in grasps.pairs for change in _pose(*pair, "the hand grasps {object}")]
    changes += _acts(releases, goals)
    changes += _acts(grasps, goals)
    changes += [] if goals or order else _structure(old, new)
    changes += _recovery(old, new)
    return tuple(changes) or (_otherwise(),)


@dataclass(frozen=True)
class _Matched:
    """Leaves of one family: those that go together, those that are gone, and those that are new; each in its order."""

    pairs: tuple[Pair, ...]
    gone: tuple[Node, ...]
    new: tuple[Node, ...]
    order: tuple[Node, ...]
    """All new leaves."""

    @staticmethod
    def of(kinds: Sequence[str], old: Sequence[Node], new: Sequence[Node]) -> _Matched:
        ours = [node for node in old if node.kind in kinds]
        theirs = [node for node in new if node.kind in kinds]
        partners = _partners(ours, theirs)
        pairs = tuple((node, theirs[partners[n]]) for n, node in enumerate(ours) if n in partners)
        gone = tuple(node for n, node in enumerate(ours) if n not in partners)
        taken = set(partners.values())
        return _Matched(pairs, gone, tuple(node for n, node in enumerate(theirs) if n not in taken), tuple(theirs))


def _leaves(tree: Tree) -> list[Node]:
    """The different leaves of what is not recovery, in the order in which the tree comes to them."""
    return list(dict.fromkeys(node for node in tree.flattened(recovery=False).walk() if node.kind in LEAVES))


def _partners(old: Sequence[Node], new: Sequence[Node]) -> dict[int, int]:
    """For the leaves of `old` their partners in `new`, by number: of the same object, the most alike first."""
    ours, theirs = _by_object(old), _by_object(new)
    costs = [
        (_unlike(old[m], new[n]), abs(i - k), m, n)
        for name in ours
        for i, m in enumerate(ours[name])
        for k, n in enumerate(theirs.get(name, ()))
    ]
    partners: dict[int, int] = {}
    taken: set[int] = set()
    for _, _, m, n in sorted(costs):
        if m not in partners and n not in taken:
            partners[m] = n
            taken.add(n)
    return partners


def _by_object(leaves: Sequence[Node]) -> dict[Any, list[int]]:
    numbers: dict[Any, list[int]] = {}
    for n, node in enumerate(leaves):
        numbers.setdefault(_of(node, "object"), []).append(n)
    return numbers


def _unlike(old: Node, new: Node) -> tuple[bool, bool, bool, float]:
    """How unlike two leaves of one object are: whether they differ at all, then frame, kind and distance, coarsely."""
    far = math.floor(_distance_m(old, new) / NEAR_M) if math.isfinite(_distance_m(old, new)) else math.inf
    return old != new, _of(old, "frame") != _of(new, "frame"), old.kind != new.kind, far


def _of(node: Node, port: str) -> Any:
    """The value of a port, None where the node has none of that name."""
    return dict(node.ports).get(port)


def _distance_m(old: Node, new: Node) -> float:
    """Between two positions [m], as if their frames were one; infinite where an entry stands for one."""
    here, there = _of(old, "position"), _of(new, "position")
    return math.dist(here, there) if isinstance(here, tuple) and isinstance(there, tuple) else math.inf


def _goals(places: _Matched) -> Iterator[Change]:
    kept = {_label(node) for pair in places.pairs for node in pair}
    for node in places.new:
        name = _told_apart(node, kept)
        yield Change("goal", _of(node, "object"), f"{name} is a goal now", None, name)
    for node in places.gone:
        name = _told_apart(node, kept)
        yield Change("goal", _of(node, "object"), f"{name} is no goal any more", name, None)


def _others(old: Sequence[Node], new: Sequence[Node]) -> Iterator[Change]:
    """What a tree asks or does beside moving objects about."""
    known = (*PLACES, *RELEASES, *GRASPS, *HANDLING)
    ours, theirs = ([node for node in nodes if node.kind not in known] for nodes in (old, new))
    for node in theirs:
        if node not in ours:
            yield Change("goal", _of(node, "object"), f"{_told(node)} counts now", None, _told(node))
    for node in ours:
        if node not in theirs:
            yield Change("goal", _of(node, "object"), f"{_told(node)} does not count any more", _told(node), None)


def _acts(acts: _Matched, goals: Sequence[Change]) -> Iterator[Change]:
    """Acts that came or went although the goals of their object did not."""
    told = {change.object for change in goals}
    for node in acts.new:
        if _of(node, "object") not in told:
            yield Change("structure", _of(node, "object"), f"there is one more {_told(node)}", None, _told(node))
    for node in acts.gone:
        if _of(node, "object") not in told:
            yield Change("structure", _of(node, "object"), f"there is no {_told(node)} any more", _told(node), None)


def _order(releases: _Matched) -> Iterator[Change]:
    """Whether what both trees bring about comes in another order."""
    kept = {node for _, node in releases.pairs}
    before = [new for _, new in releases.pairs]
    after = [node for node in releases.order if node in kept]
    if before == after:
        return
    was, now = _labels([old for old, _ in releases.pairs]), _labels(after)
    yield Change("order", None, f"the order is {_listed(now)} now; it was {_listed(was)}", was, now)


def _labels(releases: Sequence[Node]) -> list[str]:
    """What each brings about; where two have one name, with the position."""
    names = [_label(node) for node in releases]
    return [
        f"{name} {_at(node)}" if names.count(name) > 1 else name for name, node in zip(names, releases, strict=True)
    ]


def _told_apart(node: Node, others: Set[str]) -> str:
    """What a place is, with its position where another of that name is told of."""
    return f"{_label(node)} {_at(node)}" if _label(node) in others else _label(node)


def _at(node: Node) -> str:
    position = _of(node, "position")
    numbers = ", ".join(f"{1000 * v:.0f}" for v in position) if isinstance(position, tuple) else position
    return f"({numbers} mm)"


def _frames(leaves: _Matched) -> Iterator[Change]:
    for old, new in leaves.pairs:
        was, now = _of(old, "frame"), _of(new, "frame")
        if was != now:
            act = "is grasped" if new.kind in GRASPS else "is put"
            sentence = f"{_of(new, 'object')} {act} relative to {now} now; it was relative to {was}"
            yield Change("frame", _of(new, "object"), sentence, was, now)


def _together(changes: Iterable[Change]) -> list[Change]:
    """A place and the release that leads there have one frame: told once."""
    return list({change.sentence: change for change in changes}.values())


def _of_place(old: Node, new: Node) -> Iterator[Change]:
    yield from _pose(old, new, "the goal of {object} lies")
    for port, unit, factor in (("radius", "mm", 1000.0), ("angle", "degrees", math.degrees(1))):
        was, now = _of(old, port), _of(new, port)
        if was != now:
            yield _tolerance(new, unit, *(None if value is None else value * factor for value in (was, now)))


def _of_release(old: Node, new: Node) -> Iterator[Change]:
    if old.kind != new.kind:
        name, verbs = _of(new, "object"), {"Place": "placed", "Drop": "dropped"}
        sentence = f"{name} is {verbs[new.kind]} relative to {_of(new, 'frame')} now; it was {verbs[old.kind]}"
        yield Change("label", name, sentence, old.kind, new.kind)
    yield from _pose(old, new, "the hand lets {object} go")


def _tolerance(node: Node, unit: str, was: float | None, now: float | None) -> Change:
    about = f"{_label(node)} counts as reached"
    if now is None:
        sentence = f"{about} whatever way it is turned; it was within {was:.1f} {unit}"
    elif was is None:
        sentence = f"{about} only if turned within {now:.1f} {unit}; it was so whatever way it is turned"
    else:
        sentence = f"{about} within {_finely(now, was)} {unit}; it was {_finely(was, now)} {unit}"
    return Change("tolerance", _of(node, "object"), sentence, _valued(unit, was), _valued(unit, now))


def _finely(value: float, other: float) -> str:
    """A number with as many digits as tell it from the other."""
    digits = next((n for n in range(1, 9) if f"{value:.{n}f}" != f"{other:.{n}f}"), 9)
    return f"{value:.{digits}f}"


def _valued(unit: str, value: float | None) -> dict[str, float] | None:
    return None if value is None else {unit: value}


def _pose(old: Node, new: Node, what: str) -> Iterator[Change]:
    """Where position or orientation differ, in one frame: numbers in two frames cannot be compared."""
    was, now = _posed(old), _posed(new)
    if was == now or was["frame"] != now["frame"]:
        return
    told = [text for text in (_moved(was["position"], now["position"]), _turned(old, new)) if text]
    if told:
        name, subject = _of(new, "object"), what.format(object=_of(new, "object"))
        sentence = f"{subject} {' and '.join(told)} relative to {now['frame']}"
        yield Change("pose", name, sentence, _in_millimetres(was), _in_millimetres(now))


def _posed(node: Node) -> dict[str, Any]:
    return {name: _of(node, name) for name in ("frame", "position", "orientation")}


def _moved(was: Any, now: Any) -> str:
    if was == now:
        return ""
    if not (isinstance(was, tuple) and isinstance(now, tuple)):
        return f"at {now} instead of {was}"
    by = [1000 * (b - a) for a, b in zip(was, now, strict=True)]
    far = math.hypot(*by)
    return "less than 0.1 mm off" if far < 0.1 else f"{far:.1f} mm off ({', '.join(f'{v:+.1f}' for v in by)})"


def _turned(old: Node, new: Node) -> str:
    was, now = _of(old, "orientation"), _of(new, "orientation")
    if was == now or was is None or now is None:
        return ""  # whether a place goes by an orientation at all is told by its tolerance
    if not (isinstance(was, tuple) and isinstance(now, tuple)):
        return f"turned by {now} instead of {was}"
    angle = math.degrees(float(angle_between(*(_unit(each) for each in (was, now)))))
    return "turned by less than 0.1 degrees" if angle < 0.1 else f"turned by {angle:.1f} degrees"


def _unit(quaternion_xyzw: tuple[float, ...]) -> Any:
    array = np.array(quaternion_xyzw)
    return array / max(float(np.linalg.norm(array)), 1e-12)


def _in_millimetres(pose: dict[str, Any]) -> dict[str, Any]:
    position = pose["position"]
    told = [1000 * value for value in position] if isinstance(position, tuple) else position
    turned = {} if pose["orientation"] is None else {"orientation": pose["orientation"]}
    return {"frame": pose["frame"], "position_mm": told, **turned}


def _structure(old: Tree, new: Tree) -> Iterator[Change]:
    """Whether what leads to the same goals in the same order is arranged otherwise."""
    if _shape(old) != _shape(new):
        sentence = f"it is arranged otherwise: {many(new.nodes, 'node')} now, {old.nodes} before"
        yield Change("structure", None, sentence, old.nodes, new.nodes)


def _shape(tree: Tree) -> list[tuple[Any, ...]]:
    """The nodes of what is not recovery without frames, numbers and labels."""
    families = {kind: family[0] for family in (PLACES, RELEASES) for kind in family}
    nodes = tree.flattened(recovery=False).walk()
    return [(families.get(node.kind, node.kind), _of(node, "object"), len(node.children)) for node in nodes]


def _recovery(old: Tree, new: Tree) -> Iterator[Change]:
    ours, theirs = ({k: v for k, v in t.definitions.items() if k.startswith(RECOVERY_PREFIX)} for t in (old, new))
    parts = {
        "new": sorted(theirs.keys() - ours.keys()),
        "gone": sorted(ours.keys() - theirs.keys()),
        "different": sorted(name for name in ours.keys() & theirs.keys() if ours[name] != theirs[name]),
    }
    if any(parts.values()):
        told = "; ".join(f"{what} {_listed(names)}" for what, names in parts.items() if names)
        sentence = f"recovery has {many(new.nodes_recovery, 'node')} now, {old.nodes_recovery} before: {told}"
        yield Change("recovery", None, sentence, old.nodes_recovery, new.nodes_recovery)


def _otherwise() -> Change:
    return Change("structure", None, "the trees do the same and are only written otherwise")


def _label(node: Node) -> str:
    return f"{_of(node, 'object')} at {_of(node, 'frame')}"


def _told(node: Node) -> str:
    """A leaf as a person reads it."""
    ports = dict(node.ports)
    if node.kind in (*RELEASES, *GRASPS):
        return f"{node.kind} of {ports['object']} relative to {ports['frame']}"
    return f"{node.kind}({', '.join(f'{name} {value}' for name, value in node.ports)})"


def many(number: int, noun: str) -> str:
    """A number of things, as `1 node` and `2 nodes`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more
