"""What a controller concludes from poses and the gripper (CONTRACT, section 3)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from learner.errors import TreeError
from learner.execution.perception import UNSEEN_NS, CellState, condition_of
from learner.model.condition import GripperIs, GripperState, InGripper, ObjectAt, ObjectRoughlyAt
from learner.model.holding import NEAR_M
from learner.model.pose import Pose, Vector
from learner.model.query import FindGrasp
from learner.model.scene import ObjectShape, Scene
from learner.model.tree import Node, leaf
from learner.relations.answering import Answering
from learner.relations.grasping import Grasp
from learner.relations.knowledge import Knowledge

MS = 1_000_000
UPSIDE_DOWN = (1.0, 0.0, 0.0, 0.0)


class Story:
    """A cell whose clock goes on by 10 ms with every line told."""

    def __init__(self) -> None:
        self.state, self.stamp_ns = CellState("base", "tool"), 0

    def see(self, name: str, x: float, y: float = 0.0, z: float = 0.0, quaternion=UPSIDE_DOWN) -> Story:  # type: ignore[no-untyped-def]
        self.stamp_ns += 10 * MS
        self.state.update_pose(name, self.stamp_ns, Pose((x, y, z), quaternion))
        return self

    def gripper(self, state: GripperState) -> Story:
        self.stamp_ns += 10 * MS
        self.state.update_gripper(self.stamp_ns, state)
        return self

    def wait(self, duration_ns: int) -> Story:
        self.stamp_ns += duration_ns
        return self


def grasped() -> Story:
    return Story().gripper("open").see("A", 0.30).see("B", 0.34).see("tool", 0.31).gripper("closed")


def test_the_nearest_object_is_in_the_gripper_when_it_closes() -> None:
    state = grasped().state
    assert state.held == "A"
    assert state.holds(InGripper("A"))
    assert not state.holds(InGripper("B"))
    assert not state.holds(InGripper("none"))
    assert state.holds(GripperIs("closed"))


def test_a_box_gripped_far_from_its_origin_is_held_by_its_body_where_the_scene_gives_its_size() -> None:
    for shapes, held in (({"box": ObjectShape((0.30, 0.20, 0.10))}, "box"), ({}, None)):
        story = Story()
        story.state = CellState("base", "tool", Answering(Scene(shapes)))
        story.gripper("open").see("box", 0.30).see("tool", 0.41).gripper("closed")
        for step in range(60):
            story.see("tool", 0.41 + 0.01 * step).see("box", 0.30 + 0.01 * step)
        assert story.state.held == held


def test_a_gripper_that_closes_beside_everything_holds_nothing() -> None:
    story = Story().gripper("open").see("A", 0.30).see("tool", 0.30 + NEAR_M + 0.001).gripper("closed")
    assert story.state.holds(InGripper("none"))


def test_what_moves_with_the_hand_stays_held_and_what_stays_behind_does_not() -> None:
    story = grasped()
    for step in range(60):
        story.see("tool", 0.31 + 0.01 * step).see("A", 0.30 + 0.01 * step)
    assert story.state.held == "A"
    for step in range(60, 120):
        story.see("tool", 0.31 + 0.01 * step).see("A", 0.90)
    assert story.state.held is None


def test_a_turning_hand_carries_what_it_holds_around() -> None:
    story = grasped()
    for step in range(50):
        turn = math.pi * step / 49
        quaternion = (math.cos(turn / 2), math.sin(turn / 2), 0.0, 0.0)
        story.see("tool", 0.31, quaternion=quaternion)
        story.see("A", 0.31 - 0.01 * math.cos(turn), -0.01 * math.sin(turn))
    assert story.state.held == "A"


def test_one_jump_of_a_marker_opens_no_gripper() -> None:
    story = grasped().see("tool", 0.31).see("A", 0.50).see("A", 0.30).see("A", 0.50).wait(300 * MS).see("A", 0.30)
    assert story.state.held == "A"


def test_a_held_object_that_the_hand_hides_is_still_held_until_it_is_unseen_for_ten_seconds() -> None:
    story = grasped().see("tool", 0.8)
    assert story.state.holds(InGripper("A"))
    story.wait(UNSEEN_NS).see("tool", 0.9)
    assert not story.state.holds(InGripper("A"))


def test_images_that_arrive_late_are_compared_with_the_hand_of_their_moment() -> None:
    story = grasped()
    started_ns = story.stamp_ns
    for step in range(1, 60):
        story.state.update_pose("tool", started_ns + step * 10 * MS, Pose((0.31 + 0.01 * step, 0, 0), UPSIDE_DOWN))
        if step > 20:
            late = step - 20
            story.state.update_pose("A", started_ns + late * 10 * MS, Pose((0.30 + 0.01 * late, 0, 0)))
    assert story.state.held == "A"


def test_an_object_that_only_lagged_behind_is_held_again_where_the_gripper_carries_it() -> None:
    story = grasped()
    for step in range(60):
        story.see("tool", 0.31 + 0.01 * step).see("A", 0.30 + 0.01 * max(0, step - 5))
    assert story.state.held is None
    assert story.see("A", 0.89).see("tool", 0.90).state.held == "A"


def test_a_gripper_whose_clock_is_off_closes_on_what_is_at_the_hand_now() -> None:
    story = Story().wait(10_000 * MS).see("tool", 0.3).wait(1500 * MS).see("tool", 0.8).see("A", 0.8)
    story.state.update_gripper(1, "open")
    story.state.update_gripper(2, "closed")
    assert story.state.held == "A"


@pytest.mark.parametrize("hand_first", [True, False])
@pytest.mark.parametrize("hand_every", [1, 3])
def test_a_fast_hand_carries_what_it_holds_however_a_message_is_ordered(hand_first: bool, hand_every: int) -> None:
    story = grasped()
    for step in range(1, 31):
        stamp_ns = story.stamp_ns + step * 33 * MS
        message = {"A": 0.30 + 0.05 * step}
        if step % hand_every == 0:
            message = {"tool": 0.31 + 0.05 * step, **message} if hand_first else {**message, "tool": 0.31 + 0.05 * step}
        for name, x in message.items():
            story.state.update_pose(name, stamp_ns, Pose((x, 0, 0), UPSIDE_DOWN))
        assert story.state.held == "A"


@pytest.mark.parametrize("poses_first", [True, False])
def test_a_fast_hand_that_lifts_at_once_has_grasped_what_was_there_when_it_closed(poses_first: bool) -> None:
    state = CellState("base", "tool")
    state.update_gripper(1, "open")
    heights = [0.30, 0.20, 0.10, 0.02, 0.02, 0.12, 0.22, 0.32, 0.42]  # closes at the fourth
    for index, height in enumerate(heights):
        if index == 4 and not poses_first:
            state.update_gripper(4 * 33 * MS - 10 * MS, "closed")
        carried = max(0.02, height) if index > 3 else 0.02
        state.update_pose("A", (index + 1) * 33 * MS, Pose((0.3, 0.0, carried), UPSIDE_DOWN))
        state.update_pose("tool", (index + 1) * 33 * MS, Pose((0.3, 0.0, height), UPSIDE_DOWN))
        if index == 6 and poses_first:
            state.update_gripper(5 * 33 * MS - 10 * MS, "closed")
    assert state.held == "A"


def test_opening_lets_go_and_closing_again_looks_again() -> None:
    story = grasped().gripper("open")
    assert story.state.holds(InGripper("none"))
    assert story.see("tool", 0.345).gripper("closed").state.held == "B"


def test_a_gripper_already_closed_at_the_start_holds_what_is_at_the_hand() -> None:
    story = Story().gripper("closed").see("tool", 0.31).see("B", 0.33).see("A", 0.30)
    assert story.state.held == "A"
    story.see("tool", 0.5).see("A", 0.49)
    assert story.state.held == "A"


def test_nothing_is_known_of_a_gripper_that_has_not_spoken() -> None:
    state = Story().see("tool", 0.3).state
    assert not any(map(state.holds, [GripperIs("open"), GripperIs("closed"), InGripper("none"), InGripper("A")]))


def test_frozen_gripper_conditions_keep_their_values_until_thawed() -> None:
    story = Story().gripper("open").see("A", 0.30).see("tool", 0.31)
    at = ObjectAt("A", "base", (0.3, 0.0, 0.0))
    story.state.freeze_gripper()
    story.gripper("closed")
    assert story.state.holds(GripperIs("open"))
    assert story.state.holds(InGripper("none"))
    assert story.state.holds(at)
    story.state.thaw_gripper()
    assert story.state.holds(GripperIs("closed"))
    assert story.state.holds(InGripper("A"))
    assert not story.state.holds(at)


def test_a_held_object_is_nowhere_else() -> None:
    state = grasped().state
    assert not state.holds(ObjectAt("A", "base", (0.3, 0.0, 0.0)))
    assert not state.holds(ObjectRoughlyAt("A", "base", (0.3, 0.0, 0.0)))
    assert state.holds(ObjectAt("B", "base", (0.34, 0.0, 0.0)))


def test_a_sphere_has_a_height_and_a_cylinder_has_none() -> None:
    state = Story().see("A", 0.3, 0.0, 0.5).state
    assert state.holds(ObjectAt("A", "base", (0.3, 0.0, 0.46), 0.05))
    assert not state.holds(ObjectAt("A", "base", (0.3, 0.0, 0.44), 0.05))
    assert state.holds(ObjectRoughlyAt("A", "base", (0.21, 0.0, -3.0), 0.10))
    assert not state.holds(ObjectRoughlyAt("A", "base", (0.19, 0.0, 0.5), 0.10))


def test_the_cylinder_stands_upright_in_the_base_however_the_frame_lies() -> None:
    lying = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
    state = Story().see("box", 1.0, 1.0, 0.0, lying).see("A", 1.0, 1.0, 9.0).state
    assert state.holds(ObjectRoughlyAt("A", "box", (0.0, 0.2, 0.0), 0.01))
    assert not state.holds(ObjectRoughlyAt("A", "box", (0.0, 0.0, 0.2), 0.01))


def test_a_frame_is_taken_as_it_stands() -> None:
    story = Story().see("box", 1.0, quaternion=(0, 0, 1, 0)).see("A", 0.9)
    at = ObjectAt("A", "box", (0.1, 0.0, 0.0), 0.01)
    assert story.state.holds(at)
    assert not story.see("box", 1.1, quaternion=(0, 0, 1, 0)).state.holds(at)


@pytest.mark.parametrize("hidden", ["A", "box"])
def test_a_condition_on_what_was_unseen_for_ten_seconds_fails(hidden: str) -> None:
    at = ObjectAt("A", "box", (0.0, 0.0, 0.0))
    story = Story().see("A", 0.3).see("box", 0.3)
    shown = "box" if hidden == "A" else "A"
    assert story.wait(UNSEEN_NS - 30 * MS).see(shown, 0.3).state.holds(at)
    assert not story.wait(30 * MS).see(shown, 0.3).state.holds(at)


def test_an_older_pose_or_gripper_sample_changes_nothing() -> None:
    state = grasped().state
    assert not state.update_pose("A", 1, Pose((9.0, 9.0, 9.0)))
    state.update_gripper(1, "open")
    assert state.held == "A"
    assert state.pose("A") == Pose((0.30, 0.0, 0.0), UPSIDE_DOWN)


coordinates = st.floats(-2.0, 2.0)
vectors = st.tuples(coordinates, coordinates, coordinates)
quaternions = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: sum(v * v for v in q) > 0.01)


@given(frame=st.builds(Pose, vectors, quaternions), position=vectors, offset=vectors)
def test_being_in_the_sphere_is_what_the_algebra_of_poses_says(frame: Pose, position: Vector, offset: Vector) -> None:
    target = np.array(frame.apply(position))
    at = target + np.array(offset) * 0.05
    state = CellState("base", "tool")
    state.update_pose("box", 1, frame)
    state.update_pose("A", 1, Pose.of(at, (0, 0, 0, 1)))
    distance = float(np.linalg.norm(at - target))
    radius = 0.05
    if abs(distance - radius) > 1e-9:
        assert state.holds(ObjectAt("A", "box", position, radius)) == (distance < radius)
    horizontal = float(np.linalg.norm((at - target)[:2]))
    if abs(horizontal - radius) > 1e-9:
        assert state.holds(ObjectRoughlyAt("A", "box", position, radius)) == (horizontal < radius)


@pytest.mark.parametrize(
    "condition",
    [GripperIs("open"), InGripper("none"), ObjectAt("A", "b", (1.0, 2.0, 3.0)), ObjectRoughlyAt("A", "b", (0.0,) * 3)],
)
def test_a_leaf_and_its_condition_say_the_same(condition) -> None:  # type: ignore[no-untyped-def]
    assert condition_of(leaf(condition)) == condition


def test_an_action_is_no_condition() -> None:
    with pytest.raises(TreeError, match="SetGripper is no condition"):
        condition_of(Node("SetGripper", (("state", "open"),)))


@pytest.mark.parametrize(("gripper", "tried"), [("closed", False), ("open", True)])
def test_a_pick_that_began_with_a_closed_gripper_has_tried_no_grasp(gripper: GripperState, tried: bool) -> None:
    grasp = Grasp(Pose((0.0, 0.0, 0.0), UPSIDE_DOWN), object="A")
    story = Story()
    story.state = CellState("base", "tool", Answering(Scene({}), Knowledge((grasp,))))
    story.gripper(gripper).see("A", 0.3)
    story.state.freeze_gripper()
    story.state.pick_failed("A", grasp.pose)
    story.state.thaw_gripper()
    assert (story.state.find(FindGrasp("A")) is None) is tried
