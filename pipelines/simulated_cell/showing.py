"""What the simulated cell shows of itself: poses as its camera sees them, and the gripper (CONTRACT, section 1)."""

from __future__ import annotations

import math
import time
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Final, Self

import zenoh

from learner.model.condition import GripperState
from learner.simulation.cell.physics import World
from pipelines.network.publisher import declare_publisher
from pipelines.profile import Profile
from recorder.wire import (
    GRIPPER,
    GRIPPER_ENCODING,
    POSES,
    POSES_ENCODING,
    gripper_message,
    key_of,
    pose_message,
)

POSES_HZ: Final = 30.0
GRIPPER_PERIOD_S: Final = 0.5


class Showing:
    """Publishes what there is to be seen in a world, as a context. Stamps are of the wall clock.

    Frames are called as in the `profile`.
    """

    def __init__(self, session: zenoh.Session, cell: str, world: World, profile: Profile) -> None:
        self._session, self._cell, self._world, self._profile = session, cell, world, profile
        self._state: GripperState | None = None
        self._poses_due_s = self._gripper_due_s = -math.inf
        self._opened = ExitStack()

    def __enter__(self) -> Self:
        self._poses = self._declare(POSES, POSES_ENCODING, 2 * POSES_HZ)
        self._gripper = self._declare(GRIPPER, GRIPPER_ENCODING, 5 / GRIPPER_PERIOD_S)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def show(self, at_once: bool = False) -> None:
        """Publish what is due, or all of it `at_once`; the gripper whenever it has changed."""
        now_s, state = time.monotonic(), self._world.gripper.state
        if at_once or now_s >= self._poses_due_s:
            self._poses_due_s = now_s + 1 / POSES_HZ
            poses = {**self._world.observe(), self._profile.end_effector_frame: self._world.arm.tool_pose}
            self._poses.put(pose_message(time.time_ns(), self._profile.base_frame, poses))
        if at_once or now_s >= self._gripper_due_s or state != self._state:
            self._gripper_due_s, self._state = now_s + GRIPPER_PERIOD_S, state
            self._gripper.put(gripper_message(time.time_ns(), state, round(self._world.arm.width_m, 5)))

    def _declare(self, topic: str, encoding: str, rate_hz: float) -> Any:
        publisher = declare_publisher(self._session, key_of(self._cell, topic), encoding, rate_hz)
        return self._opened.enter_context(publisher)
