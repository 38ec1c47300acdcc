"""The arm's kinematics: forward and inverse are each other's inverse, wherever the cell needs to reach."""

from __future__ import annotations

import math

import numpy as np
import pytest

from learner.model import Pose
from learner.model.pose import angle_between
from learner.simulation.cell.arm_kinematics import FINGERS_LONGER_M, forward, inverse, pointing_down, tilt_rad, yaw_of
from learner.simulation.scenarios import REACH_M


def _tilted(pose: Pose, axis: float, angle: float) -> Pose:
    half = math.sin(angle / 2)
    return pose @ Pose((0.0, 0.0, 0.0), (half * math.cos(axis), half * math.sin(axis), 0.0, math.cos(angle / 2)))


@pytest.mark.parametrize("seed", range(40))
def test_the_hand_stands_where_inverse_kinematics_was_asked_to_bring_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    distance, direction = rng.uniform(*REACH_M), rng.uniform(-1.3, 1.3)
    x, y, z = distance * math.cos(direction), distance * math.sin(direction), rng.uniform(0.01, 0.33)
    target = _tilted(pointing_down(x, y, z, rng.uniform(-math.pi, math.pi)), rng.uniform(0, 6), rng.uniform(0, 0.15))

    joints = inverse(target)

    assert joints is not None
    reached = forward(joints)
    assert math.dist(reached.position, target.position) < 2e-4
    assert angle_between(np.array(reached.quaternion_xyzw), np.array(target.quaternion_xyzw)) < 2e-4


def test_the_home_of_the_data_sheet_is_where_the_data_sheet_says() -> None:
    # Franka's documented ready position, flange at (0.307, 0, 0.590) with the hand and our fingers below it.
    ready = forward(np.array([0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4]))

    assert ready.position == pytest.approx((0.307, 0.0, 0.590 - 0.105 - FINGERS_LONGER_M), abs=1e-3)
    assert tilt_rad(ready) == pytest.approx(0.0, abs=1e-6)
    assert yaw_of(ready) == pytest.approx(0.0, abs=1e-6)


def test_neighbouring_targets_have_neighbouring_joint_angles() -> None:
    here = inverse(pointing_down(0.5, 0.2, 0.1, 0.4))
    there = inverse(pointing_down(0.501, 0.2, 0.1, 0.4))

    assert here is not None
    assert there is not None
    assert np.max(np.abs(here - there)) < 0.01


@pytest.mark.parametrize(
    "target",
    [
        pointing_down(1.2, 0.0, 0.1, 0.0),
        pointing_down(0.05, 0.0, 0.1, 0.0),
        pointing_down(0.6, 0.0, 0.9, 0.0),
        Pose((0.5, 0.0, 0.3)),
        _tilted(pointing_down(0.5, 0.0, 0.3, 0.0), 0.0, math.radians(60)),
    ],
    ids=["too far", "at its own base", "too high", "pointing up", "lying"],
)
def test_what_the_arm_cannot_reach_has_no_joint_angles(target: Pose) -> None:
    assert inverse(target) is None


def test_yaw_is_what_pointing_down_was_given() -> None:
    for yaw in np.linspace(-3.1, 3.1, 9):
        assert yaw_of(pointing_down(0.4, 0.1, 0.2, float(yaw))) == pytest.approx(yaw)
