"""Where something that is held may be put aside: the nearest spot that nothing takes and no place of the tree needs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

from learner.model.pose import Pose, Vector
from learner.model.upright import block_of
from learner.relations.lying import UNTOLD, Lying

PITCH_M: Final = 0.03
"""Spots are looked for on a grid this wide [m]."""
ROOM_M: Final = 0.03
"""Between what is put aside and what stands there the fingers need this much [m]."""
PLACE_M: Final = 0.06
"""From the middle of a place that the tree names it stays this far [m], and its own radius."""
EDGE_M: Final = 0.05
"""Where no workspace is told, spots lie this much around what is seen [m] ..."""
RAISED_M: Final = 0.003
"""What is put aside is let go this much above the table [m]."""
Range = tuple[float, float]


def free_spot(lying: Lying, name: str, hand: Pose, places: Sequence[Vector]) -> Pose | None:
    """The end-effector's pose in the base at which a held object stands on the table, on a free spot; None if none is.

    The object stays turned as it is held. The spot is the nearest to where it is held now; `places` [m] in the base are
    those that the tree names. The table is where the lowest thing that is seen stands.
    """
    shape, pose = lying.scene.objects.get(name, UNTOLD), lying.poses[name]
    held = block_of(name, pose, shape.size_m)
    radius_m, x, y = math.hypot(held.half_x, held.half_y), pose.position[0], pose.position[1]
    grid = sorted(_grid(lying, radius_m), key=lambda at: (math.dist(at, (x, y)), at))
    free = (at for at in grid if _is_free(lying, at, radius_m, places))
    spot = next(free, None)
    if spot is None:
        return None
    down_m = _table_m(lying, held.bottom) + RAISED_M - held.bottom
    (a, b, c) = hand.position
    return Pose((a + spot[0] - x, b + spot[1] - y, c + down_m), hand.quaternion_xyzw)


def _is_free(lying: Lying, at: tuple[float, float], radius_m: float, places: Sequence[Vector]) -> bool:
    apart = all(math.dist(at, place[:2]) > radius_m + PLACE_M for place in places)
    return apart and lying.distance_m(*at) > radius_m + ROOM_M


def _table_m(lying: Lying, otherwise_m: float) -> float:
    """The height of the table [m]: what stands lowest stands on it."""
    return min((block.bottom for block in lying.blocks.values()), default=otherwise_m)


def _grid(lying: Lying, radius_m: float) -> Iterator[tuple[float, float]]:
    (x0, x1), (y0, y1) = lying.scene.workspace_m or _seen(lying)
    for x in _steps(x0 + radius_m, x1 - radius_m):
        for y in _steps(y0 + radius_m, y1 - radius_m):
            yield x, y


def _steps(low: float, high: float) -> list[float]:
    count = max(0, math.floor((high - low) / PITCH_M)) + 1 if high >= low else 0
    return [low + number * PITCH_M for number in range(count)]


def _seen(lying: Lying) -> tuple[Range, Range]:
    """What was seen, and a little around it."""
    xs, ys = ([pose.position[axis] for pose in lying.poses.values()] for axis in (0, 1))
    return (min(xs) - EDGE_M, max(xs) + EDGE_M), (min(ys) - EDGE_M, max(ys) + EDGE_M)
