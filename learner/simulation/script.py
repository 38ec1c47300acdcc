"""What somebody does on a table, and what must hold there in the end: the words of every simulated task.

Lengths [m], angles [rad]; positions are of an object's own origin in a frame, which is an object or the base.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from learner.model.pose import Vector

MoveType = Literal["place", "drop"]


@dataclass(frozen=True)
class ScriptedMove:
    """Pick `object`, release it so that its origin is `at` in `frame`, turned to `yaw` of the frame (None: as it was).

    A drop's `at` is where it is let go; the hand may vary it sideways by up to `spread_m`.
    """

    type: MoveType
    object: str
    frame: str
    at: Vector
    yaw: float | None = 0.0
    spread_m: float = 0.0


@dataclass(frozen=True)
class Rests:
    """A relation that must hold: the origin of `object` within `radius_m` of `at` in `frame`, released.

    `yaw` is how it is turned when somebody puts it there; what is placed beside it goes by that.
    """

    object: str
    frame: str
    at: Vector
    radius_m: float = 0.05
    yaw: float = 0.0


@dataclass(frozen=True)
class Inside:
    """A relation that must hold: the origin of `object` within the footprint of `frame` and not above its walls."""

    object: str
    frame: str
