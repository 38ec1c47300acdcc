"""The algebra of poses: laws first."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support_demonstrations import POSES, turned

from learner.errors import ModelError
from learner.model import Pose
from learner.model.pose import angle_between, conjugate, express, mean_quaternion, multiply, rotate

IDENTITY = Pose((0.0, 0.0, 0.0))
POINTS = st.tuples(*[st.floats(-5, 5)] * 3)
QUATERNIONS = POSES.map(lambda pose: pose.quaternion_xyzw)


def close(a: Pose, b: Pose) -> bool:
    angle = angle_between(np.array(a.quaternion_xyzw), np.array(b.quaternion_xyzw))
    return bool(np.allclose(a.position, b.position, atol=1e-9) and angle < 1e-7)


@given(POSES)
def test_the_identity_changes_nothing_on_either_side(pose: Pose) -> None:
    assert close(IDENTITY @ pose, pose)
    assert close(pose @ IDENTITY, pose)


@given(POSES)
def test_a_pose_and_its_inverse_cancel_on_either_side(pose: Pose) -> None:
    assert close(pose @ pose.inverse(), IDENTITY)
    assert close(pose.inverse() @ pose, IDENTITY)
    assert close(pose.inverse().inverse(), pose)


@given(POSES, POSES, POSES)
def test_composition_is_associative(a: Pose, b: Pose, c: Pose) -> None:
    assert close((a @ b) @ c, a @ (b @ c))


@given(POSES, POSES)
def test_the_inverse_of_a_composition_is_the_composition_of_inverses_turned_around(a: Pose, b: Pose) -> None:
    assert close((a @ b).inverse(), b.inverse() @ a.inverse())


@given(POSES, POSES, POINTS)
def test_composition_applies_the_right_hand_pose_first(a: Pose, b: Pose, point: tuple[float, float, float]) -> None:
    assert np.allclose((a @ b).apply(point), a.apply(b.apply(point)), atol=1e-9)


@given(POSES, POSES)
def test_expressing_a_pose_in_a_frame_and_back_is_a_round_trip(frame: Pose, pose: Pose) -> None:
    assert close(frame @ (frame.inverse() @ pose), pose)


@given(POSES, POINTS)
def test_points_are_expressed_in_a_frame_as_by_its_inverse(frame: Pose, point: tuple[float, float, float]) -> None:
    expressed = express(np.array(point), np.array(frame.position), np.array(frame.quaternion_xyzw))
    assert np.allclose(expressed, frame.inverse().apply(point), atol=1e-9)


@given(QUATERNIONS, POINTS)
def test_rotation_keeps_lengths_and_the_conjugate_undoes_it(
    quaternion: tuple[float, ...], point: tuple[float, float, float]
) -> None:
    turn, vector = np.array(quaternion), np.array(point)
    rotated = rotate(turn, vector)
    assert np.linalg.norm(rotated) == pytest.approx(np.linalg.norm(vector), abs=1e-9)
    assert np.allclose(rotate(conjugate(turn), rotated), vector, atol=1e-9)


@given(QUATERNIONS, QUATERNIONS)
def test_the_angle_between_orientations_is_symmetric_and_blind_to_signs(
    a: tuple[float, ...], b: tuple[float, ...]
) -> None:
    one, other = np.array(a), np.array(b)
    angle = float(angle_between(one, other))
    assert 0 <= angle <= math.pi + 1e-9
    assert float(angle_between(other, one)) == pytest.approx(angle, abs=1e-6)
    assert float(angle_between(-one, other)) == pytest.approx(angle, abs=1e-6)


def test_a_quarter_turn_about_the_vertical_takes_x_to_y() -> None:
    pose = Pose((1.0, 0.0, 0.0), turned(math.pi / 2))
    assert pose.apply((1.0, 0.0, 0.0)) == pytest.approx((1.0, 1.0, 0.0))
    assert pose.inverse().apply((1.0, 1.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))


def test_array_functions_broadcast_over_leading_dimensions() -> None:
    turns = np.array([turned(0.0), turned(math.pi / 2), turned(math.pi)])
    points = rotate(turns, np.array([1.0, 0.0, 0.0]))
    assert np.allclose(points, [[1, 0, 0], [0, 1, 0], [-1, 0, 0]])
    assert multiply(turns[:, None], turns[None, :]).shape == (3, 3, 4)
    assert np.allclose(angle_between(turns, turns[:1]), [0.0, math.pi / 2, math.pi])


@given(QUATERNIONS, st.lists(st.booleans(), min_size=1, max_size=6))
def test_the_mean_of_equal_orientations_is_that_orientation_whatever_their_signs(
    quaternion: tuple[float, ...], flips: list[bool]
) -> None:
    same = np.array([np.array(quaternion) * (-1 if flip else 1) for flip in flips])
    mean = mean_quaternion(same)
    assert mean[3] >= 0
    assert float(angle_between(mean, np.array(quaternion))) < 1e-6


@given(QUATERNIONS, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_the_mean_turns_with_what_it_is_the_mean_of(quaternion: tuple[float, ...], a: float, b: float) -> None:
    turn = np.array(quaternion)
    orientations = np.array([turned(a), turned(b)])
    both = mean_quaternion(multiply(turn, orientations))
    assert float(angle_between(both, multiply(turn, mean_quaternion(orientations)))) < 1e-6


def test_the_mean_of_turns_to_either_side_is_the_middle() -> None:
    mean = mean_quaternion(np.array([turned(0.2), turned(0.6)]))
    assert np.allclose(mean, turned(0.4))


def test_the_mean_does_not_break_where_angles_wrap_around() -> None:
    mean = mean_quaternion(np.array([turned(math.pi - 0.1), turned(-math.pi + 0.1)]))
    assert float(angle_between(mean, np.array(turned(math.pi)))) < 1e-6


@given(st.tuples(*[st.floats(-9, 9)] * 4).filter(lambda q: math.hypot(*q) > 0.1))
def test_quaternions_are_normalised_at_construction(quaternion: tuple[float, float, float, float]) -> None:
    pose = Pose((0.0, 0.0, 0.0), quaternion)
    assert math.hypot(*pose.quaternion_xyzw) == pytest.approx(1.0)
    assert Pose((0.0, 0.0, 0.0), pose.quaternion_xyzw) == pose


@pytest.mark.parametrize(
    ("position", "quaternion", "named"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), "quaternion"),
        ((0.0, 0.0, math.nan), (0.0, 0.0, 0.0, 1.0), "position"),
        ((0.0, 0.0, math.inf), (0.0, 0.0, 0.0, 1.0), "position"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, math.nan, 1.0), "quaternion"),
        ((0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "position"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), "quaternion"),
    ],
)
def test_what_is_no_pose_is_refused(position: tuple[float, ...], quaternion: tuple[float, ...], named: str) -> None:
    with pytest.raises(ModelError, match=named):
        Pose(position, quaternion)  # type: ignore[arg-type]
