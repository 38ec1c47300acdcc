"""What stands on what, and where a released thing comes to rest: gravity for upright bodies, without dynamics.

A body is made of upright solids (rectangles with a bottom and a top). Everything stands upright, so that a pose is a
`Spot`: the origin (the centre of the body's bounding box) and a yaw about the base frame's vertical.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal

import numpy as np

from learner.model import ObjectShape
from learner.model.upright import Block, Spot

Kind = Literal["block", "open_box"]
"""A block is solid and has its top free; an open box has a floor and four walls."""

WALL_M: Final = 0.005
"""Thickness of the walls and the floor of an open box [m]."""
TOUCH_M: Final = 0.005
"""Two faces this near to each other touch [m]."""
GIVE_M: Final = 0.015
"""What meets something by no more than this is lifted onto it instead of colliding [m]."""
SLIDE_STEP_M: Final = 0.005
SLIDE_LIMIT_M: Final = 0.45
SETTLING_STEPS: Final = 8
FROM_ABOVE_M: Final = 10.0
"""Higher than anything: whence a human puts things down [m]."""


@dataclass(frozen=True)
class Solid:
    """An upright block of a body: centre (x, y), half sizes, bottom and top [m], all in the body's own frame."""

    x: float
    y: float
    half_x: float
    half_y: float
    bottom: float
    top: float


@dataclass(frozen=True)
class Body:
    """What an object is made of. Only blocks narrower than the gripper's stroke can be grasped."""

    shape: ObjectShape
    kind: Kind = "block"
    stroke_m: float = 0.08

    @cached_property
    def solids(self) -> tuple[Solid, ...]:
        half_x, half_y, half_z = (size / 2 for size in self.shape.size_m)
        whole = Solid(0.0, 0.0, half_x, half_y, -half_z, half_z)
        if self.kind == "block":
            return (whole,)
        edge_x, edge_y, half_wall = half_x - WALL_M / 2, half_y - WALL_M / 2, WALL_M / 2
        walls = [Solid(side * edge_x, 0.0, half_wall, half_y, -half_z, half_z) for side in (-1, 1)]
        walls += [Solid(0.0, side * edge_y, half_x, half_wall, -half_z, half_z) for side in (-1, 1)]
        return (replace(whole, top=WALL_M - half_z), *walls)

    @property
    def half_height(self) -> float:
        return self.shape.size_m[2] / 2

    @property
    def graspable(self) -> bool:
        return self.kind == "block" and min(self.shape.size_m[:2]) <= self.stroke_m

    @property
    def radius(self) -> float:
        """Of the circle about its footprint [m]."""
        return math.hypot(*self.shape.size_m[:2]) / 2


def blocks(name: str, body: Body, spot: Spot) -> tuple[Block, ...]:
    """The solids of a body that stands at `spot`."""
    return tuple(
        Block(
            name,
            Spot(*spot.point(solid.x, solid.y), spot.z, spot.yaw),
            solid.half_x,
            solid.half_y,
            spot.z + solid.bottom,
            spot.z + solid.top,
        )
        for solid in body.solids
    )


class Table:
    """Bodies and where they stand, on a table whose top is z = 0; the only owner of their spots."""

    def __init__(self, bodies: Mapping[str, Body], spots: Mapping[str, Spot], rng: np.random.Generator) -> None:
        self.bodies = dict(bodies)
        self.spots = dict(spots)
        self.rng = rng
        self._solids: dict[str, tuple[Spot, tuple[Block, ...]]] = {}

    def footprint(self, name: str, spot: Spot | None = None) -> Block:
        """The outer hull of a body, where it stands or would stand at `spot`."""
        spot = spot or self.spots[name]
        half_x, half_y, half_z = (size / 2 for size in self.bodies[name].shape.size_m)
        return Block(name, spot, half_x, half_y, spot.z - half_z, spot.z + half_z)

    def obstacles(self, without: Iterable[str]) -> list[Block]:
        """The solids of every body but those `without`."""
        left_out = set(without)
        return [b for name, spot in self.spots.items() if name not in left_out for b in self._blocks(name, spot)]

    def _blocks(self, name: str, spot: Spot) -> tuple[Block, ...]:
        """The solids of a body at `spot`, worked out once while it stands there."""
        known = self._solids.get(name)
        if known is None or known[0] is not spot:
            known = self._solids[name] = spot, blocks(name, self.bodies[name], spot)
        return known[1]

    def support_m(self, name: str, spot: Spot, below_m: float = math.inf) -> float:
        """The height [m] of the highest thing under `name` at `spot` that ends `below_m` or lower; 0 is the table."""
        return max((block.top for block in self._under(name, spot) if block.top <= below_m), default=0.0)

    def _under(self, name: str, spot: Spot) -> list[Block]:
        """What the footprint overlaps, but for what hangs wholly above it (in the gripper)."""
        hull = self.footprint(name, spot)
        return [block for block in self.obstacles({name}) if block.bottom < hull.top and block.overlaps(hull)]

    def on(self, name: str) -> set[str]:
        """The bodies that stand directly on (or in) `name`."""
        own = self._blocks(name, self.spots[name])
        hulls = (self.footprint(other) for other in self.spots if other != name)
        return {hull.name for hull in hulls if any(_stands_on(hull, block) for block in own)}

    def load(self, name: str) -> set[str]:
        """Everything that stands on `name`, directly or not."""
        found: set[str] = set()
        waiting = {name}
        while waiting:
            waiting = set().union(*(self.on(one) for one in waiting)) - found - {name}
            found |= waiting
        return found

    def covered(self, name: str) -> bool:
        """Whether something stands on it."""
        return bool(self.on(name))

    def carry(self, name: str, spot: Spot) -> None:
        """Move a body with all that stands on it; nothing falls."""
        before, load = self.spots[name], self.load(name)
        moved = {other: spot.compose(before.relative(self.spots[other])) for other in load}
        self.spots.update(moved)
        self.spots[name] = spot

    def lay(self, name: str, spot: Spot) -> None:
        """Put a body onto whatever lies under `spot` (its z unused); what stood on it falls."""
        load, from_above = self.load(name), replace(spot, z=FROM_ABOVE_M)
        self.spots[name] = replace(spot, z=self.support_m(name, from_above) + self.bodies[name].half_height)
        self._settle(name)
        self.settle(load)

    def settle(self, names: Iterable[str]) -> None:
        """Let bodies fall that may have lost their support, the lowest first."""
        for name in sorted(names, key=lambda name: (self.spots[name].z, name)):
            self._settle(name)

    def drop(self, name: str, spot: Spot) -> float:
        """Release a body at `spot`: it falls, bounces, comes to rest. Returns the fall's height [m]."""
        half = self.bodies[name].half_height
        fall_m = spot.z - half - self.support_m(name, spot, spot.z - half + GIVE_M)
        self.spots[name] = self._bounced(name, spot, fall_m) if fall_m > GIVE_M else spot
        self._settle(name)
        return fall_m

    def _bounced(self, name: str, spot: Spot, fall_m: float) -> Spot:
        """Away by about an eighth of the fall's height; walls stop it."""
        reach = min(fall_m, 0.2)
        x, y = np.clip(self.rng.normal(0.0, 0.12 * reach, 2), -0.3 * reach, 0.3 * reach).tolist()
        height = self.support_m(name, spot)
        for part in (1.0, 0.75, 0.5, 0.25):
            beside = replace(spot, x=spot.x + part * x, y=spot.y + part * y)
            if self.support_m(name, beside) <= height + GIVE_M:
                return beside
        return spot

    def _settle(self, name: str) -> None:
        for _ in range(SETTLING_STEPS):
            spot = self._lowered(name)
            self.spots[name] = spot
            direction = self._falls_towards(name, spot)
            if direction is None:
                return
            self.spots[name] = self._slid(name, spot, direction)

    def _lowered(self, name: str) -> Spot:
        """Straight down (or up by what it may give) onto the highest thing below it."""
        spot, half = self.spots[name], self.bodies[name].half_height
        return replace(spot, z=self.support_m(name, spot, spot.z - half + GIVE_M) + half)

    def _falls_towards(self, name: str, spot: Spot) -> tuple[float, float] | None:
        """The way it tips, or None where its centre of mass is over what carries it."""
        height = spot.z - self.bodies[name].half_height
        carriers = [block for block in self._under(name, spot) if abs(block.top - height) < TOUCH_M]
        if height < TOUCH_M or any(block.covers(spot.x, spot.y) for block in carriers):
            return None
        touched = [p for p in self._grid(name, spot) if any(block.covers(*p) for block in carriers)]
        if _surrounded(spot, touched):
            return None
        return self._away(spot, touched)

    def _grid(self, name: str, spot: Spot) -> list[tuple[float, float]]:
        hull = self.footprint(name, spot)
        steps = (-1.0, -0.5, 0.0, 0.5, 1.0)
        return [spot.point(a * hull.half_x, b * hull.half_y) for a in steps for b in steps]

    def _away(self, spot: Spot, touched: list[tuple[float, float]]) -> tuple[float, float]:
        if touched:
            x = spot.x - sum(x for x, _ in touched) / len(touched)
            y = spot.y - sum(y for _, y in touched) / len(touched)
            length = math.hypot(x, y)
            if length > 1e-6:
                return x / length, y / length
        angle = float(self.rng.uniform(-math.pi, math.pi))
        return math.cos(angle), math.sin(angle)

    def _slid(self, name: str, spot: Spot, direction: tuple[float, float]) -> Spot:
        """Pushed sideways until it is off what it stood on; where that side is walled, another way."""
        height = spot.z - self.bodies[name].half_height
        first = math.atan2(direction[1], direction[0])
        turns = [side * k * math.pi / 6 for k in range(7) for side in (1, -1)]
        for angle in (first + turn for turn in turns):
            for step in range(1, int(SLIDE_LIMIT_M / SLIDE_STEP_M)):
                way = step * SLIDE_STEP_M
                beside = replace(spot, x=spot.x + way * math.cos(angle), y=spot.y + way * math.sin(angle))
                support = self.support_m(name, beside)
                if support > height + GIVE_M:
                    break
                if support < height - TOUCH_M:
                    return beside
        return spot


def _stands_on(hull: Block, block: Block) -> bool:
    return abs(hull.bottom - block.top) < TOUCH_M and block.overlaps(hull)


def _surrounded(spot: Spot, points: list[tuple[float, float]]) -> bool:
    """Whether the centre lies within the hull of the points: no gap of half a turn between their directions."""
    angles = sorted(math.atan2(y - spot.y, x - spot.x) for x, y in points)
    if len(angles) < 3:
        return False
    gaps = [later - earlier for earlier, later in zip(angles, [*angles[1:], angles[0] + 2 * math.pi], strict=True)]
    return max(gaps) < math.pi - 1e-6
