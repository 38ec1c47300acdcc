"""What may lie upon what, and how it is lifted off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from learner.inference.goals import Subgoal
from learner.inference.targets import Target
from learner.model import Definition, Node, ObjectAt
from learner.model.condition import PLACE_RADIUS_M
from learner.model.pose import Vector
from learner.model.tree import first_of, guarded, subtree
from learner.model.vocabulary import RECOVERY_PREFIX
from learner.planning.obstacles import Obstacles
from learner.planning.rounding import rounded, rounded_vector


@dataclass(frozen=True)
class Cover:
    """`object` lies upon `under` when its origin is within `radius` [m] of `position` [m] in the frame of `under`."""

    object: str
    under: str
    position: Vector
    radius: float
    direct: bool = True
    """Whether nothing lies between."""

    @property
    def condition(self) -> ObjectAt:
        return ObjectAt(self.object, self.under, self.position, self.radius)


@dataclass(frozen=True, eq=False)
class Covers:
    """Every covering of one obstacle by another that is possible (with a scene) or was demonstrated (without)."""

    obstacles: Obstacles
    targets: Sequence[Target]

    def of(self, name: str) -> list[Cover]:
        """What may lie upon an object."""
        return self._by_under[name]

    def raised(self, subgoal: Subgoal) -> list[Cover]:
        """What a subgoal's reference may have been put upon, so that nothing could be placed beside it.

        Only where it stood on the table whenever the operator placed something in its frame.
        """
        obstacles, frame = self.obstacles, subgoal.target.frame
        stood = obstacles.actions.moves.releases(subgoal.target.members).origin(frame)
        heights = stood.positions[stood.known, 2]
        if frame not in obstacles.picks or not len(heights) or not obstacles.has_scene:
            return []
        highest = min(obstacles.first_heights_m(frame)) + obstacles.parameters.on_table_m
        on_table = float(np.median(heights)) < highest
        return [cover for cover in self._all if cover.object == frame and cover.direct] if on_table else []

    def off(self, cover: Cover, below: tuple[str, ...] = ()) -> Node:
        """Picks a covering object. With a scene the covers of a pile are listed from its top; without, what was shown
        to lie upon the covering object goes first.
        """
        pick = self.obstacles.take(cover.object)
        if self.obstacles.has_scene:
            return pick
        higher = [other for other in self.of(cover.object) if other.object not in below]
        lifts = [guarded(other.condition, self.off(other, (*below, cover.object))) for other in higher]
        return first_of([*lifts, pick])

    def lift(self, name: str) -> Node:
        """Picks an obstacle, or what lies highest upon it."""
        return subtree(self._lift_id(name)) if self.of(name) else self.obstacles.take(name)

    @property
    def definitions(self) -> list[Definition]:
        """The SubTrees that `lift` uses."""
        return [Definition(self._lift_id(name), self._lift(name)) for name in self.obstacles.picks if self.of(name)]

    def _lift(self, name: str) -> Node:
        lifts = [guarded(cover.condition, self.off(cover, (name,))) for cover in self.of(name)]
        return first_of([*lifts, self.obstacles.take(name)])

    def _lift_id(self, name: str) -> str:
        return f"{RECOVERY_PREFIX}Lift_{self.obstacles.ids[name]}"

    @cached_property
    def _by_under(self) -> Mapping[str, list[Cover]]:
        covers = [cover for cover in self._all if cover.object in self.obstacles.picks]
        return {name: [cover for cover in covers if cover.under == name] for name in self.obstacles.picks}

    @cached_property
    def _all(self) -> list[Cover]:
        """All covers, the highest in a pile first."""
        return self._possible() if self.obstacles.has_scene else self._demonstrated()

    def _demonstrated(self) -> list[Cover]:
        upon = {(target.object, *target.upon) for target in self.targets if target.upon}
        radius_m = self.obstacles.parameters.cover_radius_m
        return [Cover(x, o, rounded_vector(at), radius_m) for x, o, at in sorted(upon)]

    def _possible(self) -> list[Cover]:
        numbers = self.obstacles.parameters
        known = [name for name in self.obstacles.picks if name in self.obstacles.shapes]
        heights = {name: self.obstacles.upright(name).height_m for name in known}
        covers = [
            (heights[o] / 2 + between_m + heights[x] / 2, x, o, between_m == 0.0)
            for o in known
            for x in known
            if x != o
            for between_m in _sums([heights[n] for n in known if n not in (x, o)], numbers.levels, numbers.merged_m)
        ]
        mixed = max(heights.values(), default=0.0) - min(heights.values(), default=0.0) > numbers.edge_m
        return [self._cover(*cover, mixed) for cover in sorted(covers, key=lambda cover: -cover[0])]

    def _cover(self, height_m: float, x: str, o: str, direct: bool, mixed: bool) -> Cover:
        """x upon o, its middle so high above that of o; where heights are mixed, others between are told apart."""
        numbers = self.obstacles.parameters
        radius = min(PLACE_RADIUS_M, self.obstacles.upright(o).sides_m[1] / 2 + numbers.edge_m)
        position = rounded_vector(self.obstacles.ups[o] * height_m)
        told_apart = not direct and mixed
        return Cover(x, o, position, rounded(min(radius, numbers.mixed_radius_m) if told_apart else radius), direct)


def _sums(heights_m: Sequence[float], levels: int, merged_m: float) -> list[float]:
    """How high [m] none to `levels` - 1 things of these heights may be upon each other; sums nearer than `merged_m`
    [m] count as one.
    """
    sums = sorted({round(sum(some), 3) for n in range(1, levels) for some in combinations(heights_m, n)})
    merged: list[list[float]] = []
    for total in sums:
        if merged and total - merged[-1][0] < merged_m:
            merged[-1].append(total)
        else:
            merged.append([total])
    return [0.0, *(float(np.mean(group)) for group in merged)]
