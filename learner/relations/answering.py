"""What a tree of vocabulary 2 asks, answered from what is seen: one code for controllers, simulations and engines."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

from learner.model.pose import Pose, Vector
from learner.model.query import (
    CountAt,
    FindGrasp,
    FindHeld,
    FindInTheWay,
    FindObject,
    FindSpot,
    FindUnder,
    FindUpon,
    Query,
    SignalIs,
    Site,
    signal_of,
)
from learner.model.scene import Scene
from learner.model.tree import Value
from learner.relations.grasping import Grasping
from learner.relations.knowledge import UNKNOWING, Knowledge
from learner.relations.lying import Lying, position_of
from learner.relations.spots import free_spot

Signal = bool | float | str
NOTHING: Final = Scene({})


@dataclass(frozen=True)
class Seen:
    """What a cell sees at a tick: `poses` in the base of the objects that were seen lately, the `hand`, what is `held`.

    `frame` gives the pose in the base of any frame, None for one of which something was not seen.
    """

    poses: Mapping[str, Pose]
    hand: Pose | None
    held: str | None
    frame: Callable[[str], Pose | None]
    signals: Mapping[str, Signal] = field(default_factory=dict)


class Answering:
    """Answers what a tree asks of a scene; remembers which grasps have failed."""

    def __init__(self, scene: Scene | None = None, knowledge: Knowledge = UNKNOWING) -> None:
        self.scene, self.places = scene or NOTHING, knowledge.places
        self.grasping = Grasping(knowledge.grasps, self.scene)
        self._last: _Search | None = None

    def holds(self, word: SignalIs | CountAt, seen: Seen) -> bool:
        """Whether a condition holds."""
        if isinstance(word, SignalIs):
            return word.signal in seen.signals and _same(seen.signals[word.signal], signal_of(word.value))
        lying = [name for name in self._of_kind(word.kind, seen) if name != seen.held]
        return sum(self._at(name, word.at, seen) for name in lying) >= word.count

    def find(self, word: Query, seen: Seen) -> dict[str, Value] | None:
        """What a query writes, by its output ports; None if it fails."""
        if self._last is None or self._last.seen is not seen:  # several are asked in one tick
            self._last = _Search(self, seen)
        return self._last.find(word)

    def _of_kind(self, kind: str, seen: Seen) -> list[str]:
        return sorted(name for name in seen.poses if name in self.scene.objects and self._kind(name) == kind)

    def _kind(self, name: str) -> str | None:
        return self.scene.objects[name].kind

    def _at(self, name: str, sites: Sequence[Site], seen: Seen) -> bool:
        """Whether an object lies at one of some places."""
        return any(_lies_at(seen.poses[name].position, site, seen) for site in sites)


@dataclass(frozen=True)
class _Search:
    """One question at one tick."""

    asked: Answering
    seen: Seen

    @cached_property
    def lying(self) -> Lying:
        return Lying(self.seen.poses, self.asked.scene, self.seen.held)

    def find(self, word: Query) -> dict[str, Value] | None:
        match word:
            case FindHeld():
                return _named("object", self.seen.held)
            case FindObject():
                return _named("object", self._object(word))
            case FindUpon(object=name):
                return _named("found", self.lying.topmost(name))
            case FindUnder(object=name):
                return _named("found", None if name == self.seen.held else self.lying.under(name))
            case FindInTheWay():
                return _named("found", self._in_the_way(word))
            case FindSpot(object=name):
                return _posed(self._spot(name))
            case FindGrasp(object=name):
                at = self.seen.poses.get(name)
                return _posed(None if at is None else self.asked.grasping.next(name, at))

    def _object(self, word: FindObject) -> str | None:
        """Of several the one held, then one that nothing lies upon, then the nearest to the hand, then by name.

        What is held lies nowhere, wherever the hand carries it.
        """
        seen, at = self.seen, self.asked._at
        lying = [name for name in self.asked._of_kind(word.kind, seen) if name != seen.held]
        fitting = [
            name for name in lying if not at(name, word.not_at, seen) and (at(name, word.at, seen) if word.at else True)
        ]
        fitting += [seen.held] if seen.held in self.asked._of_kind(word.kind, seen) and not word.at else []
        return min(fitting, key=self._rank, default=None)

    def _rank(self, name: str) -> tuple[bool, bool, float, str]:
        hand = self.seen.hand
        away = math.dist(hand.position, self.seen.poses[name].position) if hand else 0.0
        return name != self.seen.held, bool(self.lying.upon(name)), away, name

    def _in_the_way(self, word: FindInTheWay) -> str | None:
        frame = self.seen.frame(word.frame)
        if frame is None:
            return None
        movable = self.asked.grasping.graspable(self.lying.blocks)
        return self.lying.in_the_way(word.object, word.frame, position_of(frame, word.position), movable)

    def _spot(self, name: str) -> Pose | None:
        if name != self.seen.held or self.seen.hand is None or name not in self.seen.poses:
            return None
        frames = [(self.seen.frame(site.frame), site.position) for site in self.asked.places]
        places: list[Vector] = [frame.apply(position) for frame, position in frames if frame is not None]
        return free_spot(self.lying, name, self.seen.hand, places)


def _named(port: str, name: str | None) -> dict[str, Value] | None:
    return None if name is None else {port: name}


def _posed(pose: Pose | None) -> dict[str, Value] | None:
    return None if pose is None else {"position": pose.position, "orientation": pose.quaternion_xyzw}


def _lies_at(position: Vector, site: Site, seen: Seen) -> bool:
    frame = seen.frame(site.frame)
    if frame is None:
        return False
    x, y, z = frame.apply(site.position)
    height = 0.0 if site.rough else position[2] - z
    return math.hypot(position[0] - x, position[1] - y, height) <= site.radius


def _same(one: Signal, other: Signal) -> bool:
    """Equal as JSON: true is not 1."""
    return isinstance(one, bool) == isinstance(other, bool) and one == other
