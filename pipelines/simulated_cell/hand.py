"""The hand of an operator at a simulated cell: led to where a person points, by questions over Zenoh."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import zenoh

from learner.model import Pose
from learner.simulation.cell.arm_kinematics import pointing_down
from pipelines.errors import CommandError
from pipelines.network.question import ask

DRAG_LIMIT_S: Final = 120.0
QUARTER: Final = math.pi / 2
QUARTERS: Final = (0, 1, -1, 2)


@dataclass(frozen=True)
class Hand:
    """The hand in the cell of this name."""

    session: zenoh.Session
    cell: str

    def lead(self, target: str, offset_m: Sequence[float], turn_deg: float | None = None) -> dict[str, Any]:
        """Lead the hand, pointing down, to `offset_m` (3,) from an object's origin along its axes, or in the base.

        An empty hand turns as the target is turned, by the nearest quarter, as a grasp needs it; one that holds
        something stays as it is turned. `turn_deg` is from the target's x axis. Raises CommandError for a target that
        is not there, and with what was met on the way; returns the cell's truth after it.
        """
        truth, scene = self._ask("truth"), self._ask("scene")
        hand = _pose(truth["poses"][scene["end_effector_frame"]])
        frame = _frame(target, truth["poses"], scene["base_frame"])
        if turn_deg is not None:
            yaws = [yaw_of(frame) + math.radians(turn_deg)]
        elif truth["held"]:
            yaws = [yaw_of(hand)]
        else:
            yaws = _quarters(yaw_of(frame), yaw_of(hand))
        self._drag([pointing_down(*frame.apply(offset_m), yaw) for yaw in yaws])
        return self._ask("truth")

    def grip(self, state: str) -> dict[str, Any]:
        """Move the fingers where the hand is; returns the cell's truth after it."""
        self._act("grip", {"state": state})
        return self._ask("truth")

    def _drag(self, targets: Sequence[Pose]) -> None:
        """To the first of the targets that can be reached."""
        for number, target in enumerate(targets, start=1):
            try:
                self._act("drag", {"position": target.position, "orientation": target.quaternion_xyzw})
            except CommandError:
                if number == len(targets):
                    raise
            else:
                return

    def _act(self, what: str, fields: Mapping[str, Any]) -> None:
        reply = self._ask(what, fields, DRAG_LIMIT_S)
        if reply["status"] != "success":
            raise CommandError(f"the hand stopped: {reply['reason']}")

    def _ask(self, what: str, fields: Mapping[str, Any] | None = None, timeout_s: float = 10.0) -> dict[str, Any]:
        return ask(self.session, f"treewright/{self.cell}/sim/{what}", fields or {}, timeout_s)


def yaw_of(pose: Pose) -> float:
    """The yaw [rad] about the vertical of an upright object, or of a hand that points down."""
    ahead = np.subtract(pose.apply((1.0, 0.0, 0.0)), pose.position)
    return math.atan2(ahead[1], ahead[0])


def _quarters(yaw_rad: float, near_rad: float) -> list[float]:
    """A yaw and its quarter turns, that nearest to another first."""
    first = yaw_rad + QUARTER * round((near_rad - yaw_rad) / QUARTER)
    return [first + QUARTER * quarter for quarter in QUARTERS]


def _frame(name: str, poses: Mapping[str, Any], base: str) -> Pose:
    if name == base:
        return Pose((0.0, 0.0, 0.0))
    if name not in poses:
        raise CommandError(f"the cell has no {name!r}; it has {', '.join([base, *sorted(poses)])}")
    return _pose(poses[name])


def _pose(data: Mapping[str, Any]) -> Pose:
    return Pose.of(data["position"], data["orientation"])
