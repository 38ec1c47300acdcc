"""Means of poses modulo the turns that look the same, and numbers as trees carry them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support_demonstrations import GRASP, POSES, at, turned

from learner.model import Pose
from learner.model.pose import angle_between
from learner.model.poses import Poses
from learner.model.scene import Symmetry
from learner.planning.parameters import MeanParameters
from learner.planning.rounding import rounded, rounded_pose
from learner.planning.symmetry import agreeing_in_object, mean_in_object, mean_of_object, robust_mean, upright_axis

UP = np.array([0.0, 0.0, 1.0])
NEAR = MeanParameters(aligned_rad=math.radians(25))
YAWS = st.lists(st.floats(-0.05, 0.05), min_size=3, max_size=6)
COUNTS = st.sampled_from([("box", 2), ("cube", 4)])


def turn(yaw: float) -> Pose:
    return Pose((0.0, 0.0, 0.0), turned(yaw))


def angle(a: Pose, b: Pose) -> float:
    return float(angle_between(np.array(a.quaternion_xyzw), np.array(b.quaternion_xyzw)))


def off(a: Pose, b: Pose, count: int) -> float:
    """The angle [rad] between grasps of an object of which `count` turns look the same."""
    return min(angle(turn(2 * math.pi / count * k) @ a, b) for k in range(count))


@settings(max_examples=40, deadline=None)
@given(YAWS, COUNTS, st.lists(st.integers(0, 3), min_size=6, max_size=6))
def test_turns_that_look_the_same_do_not_change_the_mean_grasp(
    yaws: list[float], shape: tuple[Symmetry, int], turns: list[int]
) -> None:
    symmetry, count = shape
    grasps = [turn(yaw) @ GRASP for yaw in yaws]
    turned_grasps = [turn(2 * math.pi / count * k) @ grasp for k, grasp in zip(turns, grasps, strict=False)]
    mean = mean_in_object(Poses.of(grasps), symmetry, UP, NEAR)
    again = mean_in_object(Poses.of(turned_grasps), symmetry, UP, NEAR)
    assert off(again, mean, count) < 1e-6
    assert math.dist(again.position, mean.position) < 1e-9


@settings(max_examples=40, deadline=None)
@given(YAWS, COUNTS, st.lists(st.integers(0, 3), min_size=6, max_size=6))
def test_turns_of_the_object_do_not_change_its_mean_rest(
    yaws: list[float], shape: tuple[Symmetry, int], turns: list[int]
) -> None:
    symmetry, count = shape
    rests = [at(0.1, 0.2, yaw=yaw) for yaw in yaws]
    turned_rests = [rest @ turn(2 * math.pi / count * k) for k, rest in zip(turns, rests, strict=False)]
    mean = mean_of_object(Poses.of(rests), symmetry, UP, NEAR)
    again = mean_of_object(Poses.of(turned_rests), symmetry, UP, NEAR)
    assert off(again.inverse(), mean.inverse(), count) < 1e-6
    assert again.position == pytest.approx(mean.position)


@given(st.lists(st.floats(-3, 3), min_size=2, max_size=5))
def test_what_may_turn_freely_about_its_vertical_is_one_grasp_at_any_yaw(yaws: list[float]) -> None:
    mean = mean_in_object(Poses.of([turn(yaw) @ GRASP for yaw in yaws]), "vertical", UP, NEAR)
    assert min(angle(turn(yaw) @ GRASP, mean) for yaw in yaws) < 1e-6


@given(st.floats(-math.pi, math.pi), st.sampled_from(["none", "box", "cube", "vertical"]))
def test_the_mean_of_one_grasp_is_that_grasp(yaw: float, symmetry: Symmetry) -> None:
    assert angle(mean_in_object(Poses.of([turn(yaw) @ GRASP]), symmetry, UP, NEAR), turn(yaw) @ GRASP) < 1e-6


@given(COUNTS, st.integers(0, 3), st.floats(0.0, 0.05))
def test_grasps_agree_modulo_the_turns_that_look_the_same(
    shape: tuple[Symmetry, int], quarter: int, off_rad: float
) -> None:
    symmetry, count = shape
    alike, other = turn(2 * math.pi / count * quarter + off_rad) @ GRASP, turn(0.6) @ GRASP
    agreeing = agreeing_in_object(
        Poses.of([other, alike, GRASP]), np.array(GRASP.quaternion_xyzw), symmetry, UP, MeanParameters(aligned_rad=0.1)
    )
    assert [agreeing.pose(row) for row in range(len(agreeing))] == [alike, GRASP]


def test_without_symmetry_grasps_at_quarter_turns_are_two_and_the_more_frequent_one_counts() -> None:
    grasps = [GRASP, turn(math.pi / 2) @ GRASP, GRASP]
    assert angle(mean_in_object(Poses.of(grasps), "none", UP, NEAR), GRASP) < 1e-9


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1)])
def test_the_upright_axis_of_a_marker_glued_on_any_side_is_found(axis: tuple[int, int, int]) -> None:
    wanted = np.array(axis, dtype=float)
    half = np.cross(wanted, UP)
    glued = Pose((0.0, 0.0, 0.0), (*half.tolist(), 1.0 + float(wanted @ UP))) if wanted[2] > -1 else Pose(
        (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    )  # fmt: skip
    poses = [turn(yaw) @ glued @ Pose((0.0, 0.0, 0.0), turned(0.1)) for yaw in (0.0, 1.0, 2.0)]
    assert np.allclose(upright_axis(Poses.of(poses)), wanted)


def test_a_stray_is_left_out_of_the_mean() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.0], [0.001, 0.0, 0.0], [0.5, 0.5, 0.0]])
    assert np.allclose(robust_mean(points, NEAR), [0.001, 0.0, 0.0])


@given(st.floats(-10, 10))
def test_rounding_is_to_micrometres_stable_and_without_a_negative_zero(value: float) -> None:
    assert abs(rounded(value) - value) <= 0.5e-6 + 1e-12
    assert rounded(rounded(value)) == rounded(value)
    assert math.copysign(1.0, rounded(-1e-9)) == 1.0


@given(POSES)
def test_a_pose_and_the_same_with_the_opposite_quaternion_round_to_the_same_numbers(pose: Pose) -> None:
    x, y, z, w = pose.quaternion_xyzw
    opposite = Pose(pose.position, (-x, -y, -z, -w))
    assert rounded_pose(pose).quaternion_xyzw == rounded_pose(opposite).quaternion_xyzw
    assert angle(rounded_pose(pose), pose) < 1e-5


def test_grasps_at_quarter_turns_of_an_unknown_shape_tell_together_where_it_is_grasped() -> None:
    rng, errors = np.random.default_rng(5), []
    for _ in range(40):
        grasps = [turn(math.pi / 2 * k) @ GRASP for k in range(4)]
        missed = [Pose.of(np.add(grasp.position, rng.normal(0.0, 0.004, 3)), grasp.quaternion_xyzw) for grasp in grasps]
        mean = mean_in_object(Poses.of(missed), "none", UP, MeanParameters())
        assert off(mean, GRASP, 4) < math.radians(1)
        errors.append(math.dist(mean.position, GRASP.position))
    assert np.mean(errors) < 0.0045, "four grasps of 4 mm of noise, not one"
