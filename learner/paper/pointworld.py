"""The simulator of the paper's planner: objects are points, and every action works (section III-C).

A position in the frame of an object is a shift of that object's point: nothing turns, nothing rests on anything, and
nothing is in the way. What is moved moves alone: what was placed in its frame before no longer lies there. So it is in
the published code; but there what is held stays where it was until it is placed, here it is nowhere, as in a cell.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

from learner.model import Action, Condition, GripperIs, InGripper, ObjectAt, Pick, SetGripper
from learner.model.condition import GripperState
from learner.model.names import NONE

Point = tuple[float, float, float]

APART_M: Final = 100.0
"""What lies somewhere lies this far from everything else [m], along x."""


class PointWorld:
    """Where the points are, what the gripper holds and whether it is open. The base frame is one of `frames`."""

    def __init__(self, frames: Iterable[str]) -> None:
        self.frames = sorted(set(frames))
        self.reset()

    def reset(self) -> None:
        """Everything lies somewhere, where no condition asks for it; the gripper is open and holds nothing."""
        self.points: dict[str, Point | None] = {name: self._somewhere(name) for name in self.frames}
        self.gripper: GripperState = "open"
        self.held = NONE

    def holds(self, condition: Condition) -> bool:
        """Whether a condition holds. What is held is nowhere, nor is anything in its frame."""
        if isinstance(condition, GripperIs):
            return self.gripper == condition.state
        if isinstance(condition, InGripper):
            return self.held == condition.object
        place, there = self._in_frame(condition.frame, condition.position), self.points[condition.object]
        if place is None or there is None:
            return False
        axes = 3 if isinstance(condition, ObjectAt) else 2
        return math.dist(place[:axes], there[:axes]) <= condition.radius

    def do(self, action: Action) -> None:
        """Carry out an action. Whatever the gripper lets go otherwise than by a Place or Drop lies somewhere."""
        if isinstance(action, SetGripper):
            if action.state == "open":
                self._release(None)
            self.gripper = action.state
        elif isinstance(action, Pick):
            self._release(None)
            self.held, self.gripper, self.points[action.object] = action.object, "closed", None
        else:
            self._release(self._in_frame(action.frame, action.rest) if self.held == action.object else None)
            self.gripper = "open"

    def _release(self, at: Point | None) -> None:
        if self.held != NONE:
            self.points[self.held] = at or self._somewhere(self.held)
        self.held = NONE

    def _somewhere(self, name: str) -> Point:
        return (APART_M * self.frames.index(name), 0.0, 0.0)

    def _in_frame(self, frame: str, position: Point) -> Point | None:
        origin = self.points[frame]
        return None if origin is None else (origin[0] + position[0], origin[1] + position[1], origin[2] + position[2])
