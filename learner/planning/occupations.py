"""What may occupy the place of a target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from learner.inference.targets import Target
from learner.model import ObjectAt, ObjectRoughlyAt, Place
from learner.model.condition import DROP_RADIUS_M, PLACE_RADIUS_M
from learner.planning.obstacles import Obstacles
from learner.planning.rounding import rounded

Occupation = ObjectAt | ObjectRoughlyAt
"""An object on a place, or, roughly, partly on it."""


@dataclass(frozen=True, eq=False)
class Occupations:
    """The obstacles that may stand on the places of the targets.

    `widened` names objects that occupy the place of a target even where they stand only partly on it.
    """

    obstacles: Obstacles
    targets: Sequence[Target]
    widened: frozenset[tuple[Target, str]] = frozenset()

    def of(self, target: Target) -> Sequence[Occupation]:
        """Which other objects may occupy the place of a target. Dropping needs no free place."""
        place = self.obstacles.actions.placements[target]
        if not self.obstacles.has_scene or not isinstance(place, Place):
            return []
        others = [name for name in sorted(self.obstacles.picks) if name not in (target.object, place.frame)]
        return [
            ObjectRoughlyAt(name, place.frame, place.rest, self._touching_m(name, target.object))
            if (target, name) in self.widened
            else ObjectAt(name, place.frame, place.rest, self._occupying_m(name, target.object))
            for name in others
        ]

    def astray(self, frame: str) -> list[Occupation]:
        """The places of targets that a reference may occupy, but for those that lie in its own frame."""
        apart = [target for target in self.targets if frame not in self._carriers(target)]
        return [condition for target in apart for condition in self.of(target) if condition.object == frame]

    def _carriers(self, target: Target) -> set[str]:
        """The frame of a target, that of the target which places this frame, and so on."""
        carriers: set[str] = set()
        frames = {target.frame}
        while frames - carriers:
            carriers |= frames
            frames = {other.frame for other in self.targets if other.object in carriers}
        return carriers

    def _occupying_m(self, a: str, b: str) -> float:
        """The distance [m] of two origins below which one leaves no room for the other."""
        sides = [self.obstacles.upright(name).sides_m[0] for name in (a, b) if name in self.obstacles.shapes]
        occupies = self.obstacles.parameters.occupies
        return rounded(min(PLACE_RADIUS_M, occupies * sum(sides) / len(sides) if sides else PLACE_RADIUS_M))

    def _touching_m(self, a: str, b: str) -> float:
        """The distance [m] of two origins below which the outlines may touch, whatever the yaws."""
        shapes = self.obstacles.shapes
        sizes = [shapes[name].size_m[:2] for name in (a, b) if name in shapes]
        reach_m = sum(float(np.hypot(x, y)) for x, y in sizes) / 2
        return rounded(min(DROP_RADIUS_M, self.obstacles.parameters.touch_m + reach_m))
