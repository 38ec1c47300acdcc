"""Grasps that nobody demonstrated: borrowed from the most similar object, from the same side."""

from __future__ import annotations

import math

import numpy as np
import pytest

from learner.model import ObjectShape, Pose
from learner.model.pose import rotate
from learner.planning.grasps import Upright, borrowed_grasp, quarter_turned
from learner.planning.parameters import GraspParameters

Z, X = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
GRASPS = GraspParameters()
DOWN = (1.0, 0.0, 0.0, 0.0)
CUBE, TALL = Upright(ObjectShape((0.05, 0.05, 0.05)), Z), Upright(ObjectShape((0.06, 0.04, 0.12)), Z)
FROM_ABOVE = Pose((0.004, 0.0, 0.01), DOWN)
"""Habitually beside the middle and a little above it."""


def lent(of: Upright) -> Pose | None:
    return borrowed_grasp(of, {"A": FROM_ABOVE}, {"A": CUBE}, GRASPS)


def test_what_has_the_shape_of_a_picked_object_is_grasped_exactly_alike() -> None:
    assert lent(CUBE) is FROM_ABOVE


def test_what_has_another_shape_is_grasped_over_its_middle_at_the_same_share_of_its_height() -> None:
    grasp = lent(TALL)
    assert grasp is not None
    assert grasp.position == pytest.approx((0.0, 0.0, 0.01 / 0.05 * 0.12))
    assert rotate(np.array(grasp.quaternion_xyzw), Z) == pytest.approx(-Z)


def test_an_object_that_stands_on_another_axis_is_grasped_from_above_too() -> None:
    grasp = lent(Upright(ObjectShape((0.06, 0.05, 0.04)), X))
    assert grasp is not None
    assert grasp.position == pytest.approx((0.012, 0.0, 0.0))
    assert rotate(np.array(grasp.quaternion_xyzw), Z) == pytest.approx(-X)


def test_an_object_whose_marker_is_upside_down_is_grasped_from_above_too() -> None:
    grasp = lent(Upright(ObjectShape((0.06, 0.06, 0.06)), -Z))
    assert grasp is not None
    assert rotate(np.array(grasp.quaternion_xyzw), Z) == pytest.approx(Z)


@pytest.mark.parametrize("side_m", [GRASPS.stroke_m + 0.01, 0.3])
def test_what_a_gripper_does_not_span_in_either_direction_is_not_grasped(side_m: float) -> None:
    assert lent(Upright(ObjectShape((side_m, side_m, 0.05)), Z)) is None
    assert lent(Upright(ObjectShape((side_m, 0.04, 0.05)), Z)) is not None


def test_four_quarter_turns_are_none_and_one_is_a_right_angle_about_the_upright_axis() -> None:
    grasp = FROM_ABOVE
    for expected in [(0.0, 0.004, 0.01), (-0.004, 0.0, 0.01), (0.0, -0.004, 0.01), (0.004, 0.0, 0.01)]:
        grasp = quarter_turned(grasp, Z)
        assert grasp.position == pytest.approx(expected)
        assert rotate(np.array(grasp.quaternion_xyzw), Z) == pytest.approx(-Z)
    assert rotate(np.array(grasp.quaternion_xyzw), X) == pytest.approx(rotate(np.array(DOWN), X))


def test_without_anything_picked_nothing_is_borrowed() -> None:
    assert borrowed_grasp(CUBE, {}, {"A": CUBE}, GRASPS) is None


def test_the_most_similar_object_lends_its_grasp() -> None:
    turned = Pose((0.0, 0.0, 0.0), (math.sin(math.pi / 4), math.cos(math.pi / 4), 0.0, 0.0))
    grasp = borrowed_grasp(
        Upright(ObjectShape((0.06, 0.04, 0.11)), Z), {"A": FROM_ABOVE, "T": turned}, {"A": CUBE, "T": TALL}, GRASPS
    )
    assert grasp is not None
    assert grasp.quaternion_xyzw == pytest.approx(turned.quaternion_xyzw)
