"""What lies upon, under and in the way of what, by poses and sizes alone (CONTRACT, section 3, vocabulary 2)."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from learner.model.frame import BETWEEN, objects_of
from learner.model.pose import Pose, Vector
from learner.model.scene import ObjectShape, Scene
from learner.model.upright import Block, Spot, block_of

SEEN_M: Final = 0.003
"""What a cell sees is off by so much [m], one standard deviation, where no scene tells its accuracy."""
SURE: Final = 3.0
"""Differences of more standard deviations than this are no noise."""
GAP_M: Final = 0.015
"""Between things of which one lies upon the other at most this much is seen [m]."""
OVERLAP_M: Final = 0.008
"""Outlines that overlap by no more than this may stand beside each other [m]: noise, and turns that are seen wrong."""
SLENDER: Final = 0.4
"""... or by this share of the narrower side, where that is less."""
UNTOLD: Final = ObjectShape((0.02, 0.02, 0.02))
"""The room that an object needs of which no scene tells the size."""


@dataclass(frozen=True)
class Lying:
    """How the objects of a scene lie, as they are seen: `poses` in the base, and what is `held`, which lies nowhere.

    Objects of which the scene tells no size are points: they lie upon nothing, and nothing upon them.
    """

    poses: Mapping[str, Pose]
    scene: Scene
    held: str | None = None

    @cached_property
    def blocks(self) -> Mapping[str, Block]:
        """The room that each object of known size fills, unless it is held; by name, sorted."""
        known = sorted((self.poses.keys() & self.scene.objects.keys()) - {self.held})
        return {name: block_of(name, self.poses[name], self.scene.objects[name].size_m) for name in known}

    def upon(self, name: str) -> list[str]:
        """What lies directly upon an object: over its outline, above its middle. What lies in an open one does not."""
        under = self.blocks.get(name)
        if under is None:
            return []
        return [other for other, block in self.blocks.items() if other != name and self._lies_upon(block, under)]

    def _lies_upon(self, block: Block, under: Block) -> bool:
        if block.bottom > under.top + GAP_M or not _share(block, under):
            return False
        return block.bottom > (under.top - GAP_M if self.scene.objects[under.name].open else _middle(under))

    def topmost(self, name: str) -> str | None:
        """The highest of all that lies upon an object, directly or not; None if nothing does."""
        load: set[str] = set()
        waiting = {name}
        while waiting:
            waiting = {other for one in waiting for other in self.upon(one)} - load - {name}
            load |= waiting
        return max(load, key=lambda other: (self.blocks[other].bottom, other), default=None)

    def under(self, name: str) -> str | None:
        """What an object lies upon, the highest of several; None for the table, and what is open or fixed."""
        below = [other for other in self.blocks if other != name and name in self.upon(other)]
        highest = max(below, key=lambda other: (self.blocks[other].top, other), default=None)
        if highest is None or self.scene.objects[highest].open or self.scene.objects[highest].fixed:
            return None
        return highest

    def in_the_way(self, name: str, frame: str, place: Pose, movable: Set[str]) -> str | None:
        """The topmost of what takes the room that an object needs to come down to a place in a frame.

        `place` is the pose in the base at which its origin shall rest. Its outline is taken as its narrower side,
        square to the frame, since a place says nothing of turns. What is fixed or not `movable` cannot be put aside,
        the frame's own object belongs there (not the two that a place is midway between), what is open is entered.
        """
        room = self._room(name, place)
        belonging = {name} if BETWEEN in frame else {name, *objects_of(frame)}
        others = {other: block for other, block in self.blocks.items() if other in movable}
        blocking = [other for other, block in others.items() if self._blocks(block, room, belonging)]
        highest = max(blocking, key=lambda other: (self.blocks[other].top, other), default=None)
        return None if highest is None else self.topmost(highest) or highest

    def _room(self, name: str, place: Pose) -> Block:
        """What the object fills at the place."""
        shape = self.scene.objects.get(name, UNTOLD)
        stands = block_of(name, self.poses.get(name, place), shape.size_m)
        half, half_height = min(stands.half_x, stands.half_y), (stands.top - stands.bottom) / 2
        z = place.position[2]
        return Block(name, Spot.of(place), half, half, z - half_height, z + half_height)

    def _blocks(self, block: Block, room: Block, belonging: Set[str]) -> bool:
        shape = self.scene.objects[block.name]
        if block.name in belonging or shape.fixed or not _share(block, room):
            return False
        seen_m = SURE * (self.scene.accuracy_m or SEEN_M)
        rises = block.top > room.bottom + max(seen_m, min(GAP_M, (block.top - block.bottom) / 2))
        entered = shape.open and block.covers(room.spot.x, room.spot.y) and room.bottom < block.top - seen_m
        return rises and not entered

    def distance_m(self, x: float, y: float) -> float:
        """From a point of the base to the nearest outline [m]."""
        return min((_away_m(block, x, y) for block in self.blocks.values()), default=float("inf"))


def _share(one: Block, other: Block) -> bool:
    """Whether two outlines share more than noise can make them."""
    narrow = 2 * min(one.half_x, one.half_y, other.half_x, other.half_y)
    return one.overlaps(other, min(OVERLAP_M, SLENDER * narrow))


def _middle(block: Block) -> float:
    return (block.bottom + block.top) / 2


def _away_m(block: Block, x: float, y: float) -> float:
    along, across = block.spot.within(x, y)
    outside = (max(0.0, abs(along) - block.half_x), max(0.0, abs(across) - block.half_y))
    return float((outside[0] ** 2 + outside[1] ** 2) ** 0.5)


def position_of(pose: Pose, position: Vector) -> Pose:
    """The pose with the axes of a frame at a position [m] in it."""
    return Pose(pose.apply(position), pose.quaternion_xyzw)
