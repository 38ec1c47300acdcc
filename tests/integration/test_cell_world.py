"""The physical world: grasps, contacts and disturbances are what physics makes of them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from learner.model import Pose
from learner.simulation.cell import skills
from learner.simulation.cell.arm_kinematics import pointing_down, yaw_of
from learner.simulation.cell.bodies import UnknownObjectError
from learner.simulation.cell.camera import Noise
from learner.simulation.cell.physics import World
from learner.simulation.cell.skills import SUCCESS, Skill, SkillResult
from learner.simulation.failure import Failure
from learner.simulation.scenarios import BASE, SCENARIOS

STANDING = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture
def world() -> Iterator[World]:
    """Four cubes and a box at known places, a steady camera."""
    with World("tower_and_box", np.random.default_rng(0), Noise(0.0, 0.0)) as world:
        world.teleport("box", Pose((0.5, -0.5, 0.04), STANDING), with_content=False)
        for name, (x, y) in {"A": (0.5, 0.0), "D": (0.5, 0.2), "E": (0.5, -0.2), "F": (0.6, 0.35)}.items():
            world.teleport(name, Pose((x, y, 0.025), STANDING))
        yield world


def perform(world: World, skill: Skill) -> SkillResult:
    outcomes = []

    def activity() -> Iterator[None]:
        outcomes.append((yield from skill))

    world.activity = activity()  # type: ignore[assignment]  # an Iterator that is a generator
    while world.activity is not None:
        world.step()
    return outcomes[0]


def grasp(world: World, name: str, along: float = 0.0, across: float = 0.0, up: float = 0.0, yaw: float = 0.0) -> Pose:
    """The hand at an object, missing it along its fingers' way, across it, in height and in yaw."""
    cube = world.pose_in_base(name)
    x, y, z = np.add(cube.position, cube.apply((across, along, up))) - np.array(cube.position)
    return pointing_down(x, y, z, yaw_of(cube @ Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))) + yaw)


def pick(world: World, name: str, **misses: float) -> SkillResult:
    return perform(world, skills.pick(world, name, BASE, grasp(world, name, **misses)))


def place(world: World, name: str, x: float, y: float, z: float) -> SkillResult:
    return perform(world, skills.place(world, name, BASE, pointing_down(x, y, z, 0.0)))


def test_a_cube_grasped_well_is_lifted_and_moves_with_the_hand(world: World) -> None:
    assert pick(world, "A") == SUCCESS

    assert world.held == "A"
    assert world.gripper.state == "closed"
    assert math.dist(world.pose_in_base("A").position, world.arm.tool_pose.position) < 0.005
    assert world.pose_in_base("A").position[2] > 0.2


@pytest.mark.parametrize(
    "misses",
    [{"across": 0.007}, {"along": 0.007}, {"up": 0.008}, {"yaw": 0.2}, {"yaw": math.pi / 2}],
    ids=str,
)
def test_a_grasp_within_a_centimetre_and_fifteen_degrees_of_a_face_holds(
    world: World, misses: dict[str, float]
) -> None:
    assert pick(world, "A", **misses).status == "success"


@pytest.mark.parametrize(
    "misses", [{"across": 0.018}, {"across": 0.0115}, {"yaw": 0.4}, {"yaw": math.pi / 4}, {"up": 0.035}], ids=str
)
def test_a_worse_grasp_does_not_hold(world: World, misses: dict[str, float]) -> None:
    outcome = pick(world, "A", **misses)

    assert outcome.status == "failure"
    assert str(outcome.reason).startswith(("A is not held", "contact with A"))  # at 45 degrees it does not fit between
    assert world.held is None
    world.run(0.5)
    assert world.pose_in_base("A").position[2] < 0.05


def test_the_box_cannot_be_grasped_by_its_wall(world: World) -> None:
    world.teleport("box", Pose((0.45, 0.0, 0.04), STANDING))
    wall = Pose((0.45 + 0.1475, 0.0, 0.06), STANDING)

    outcome = perform(world, skills.pick(world, "box", BASE, pointing_down(*wall.position, math.pi / 2)))

    assert outcome.status == "failure"
    assert world.held is None


def test_a_pick_with_a_closed_gripper_fails_without_moving(world: World) -> None:
    perform(world, skills.set_gripper(world, "closed"))
    before = world.arm.tool_pose

    assert pick(world, "A") == SkillResult(Failure("gripper closed", "A"))
    assert math.dist(world.arm.tool_pose.position, before.position) < 0.001


def test_picking_one_cube_where_another_stands_fails_with_both_names(world: World) -> None:
    outcome = perform(world, skills.pick(world, "A", BASE, grasp(world, "D")))

    assert outcome.status == "failure"
    assert "D" in str(outcome.reason)
    assert "A" in str(outcome.reason)


def test_a_covered_cube_is_not_picked_and_the_contact_is_told(world: World) -> None:
    world.teleport("D", Pose((0.5, 0.0, 0.075), STANDING))
    world.run(0.2)

    outcome = pick(world, "A")

    assert outcome.status == "failure"
    assert "contact with D" in str(outcome.reason)
    assert world.held is None


def test_a_tower_is_stacked_and_stands(world: World) -> None:
    for upper, height in (("D", 0.075), ("F", 0.125)):
        assert pick(world, upper) == SUCCESS
        assert place(world, upper, 0.5, -0.2, height) == SUCCESS
    world.run(1.0)

    assert world.pose_in_base("F").position == pytest.approx((0.5, -0.2, 0.125), abs=0.004)
    assert world.gripper.state == "open"


def test_a_place_that_is_taken_fails_on_contact_still_holding(world: World) -> None:
    pick(world, "A")

    outcome = place(world, "A", 0.5, 0.2, 0.025)

    assert outcome.status == "failure"
    assert "contact with D" in str(outcome.reason)
    assert world.held == "A"
    assert world.gripper.state == "closed"


def test_a_target_a_little_below_the_support_counts_as_reached(world: World) -> None:
    pick(world, "A")

    assert place(world, "A", 0.45, 0.1, 0.025 - 0.008) == SUCCESS
    world.run(0.5)
    assert world.pose_in_base("A").position == pytest.approx((0.45, 0.1, 0.025), abs=0.004)


def test_placing_what_is_not_held_fails_and_names_what_is(world: World) -> None:
    assert place(world, "A", 0.5, 0.1, 0.025).reason == "A is not held: the gripper holds nothing"
    pick(world, "D")
    assert place(world, "A", 0.5, 0.1, 0.025).reason == "A is not held: the gripper holds D"


def test_a_cube_taken_away_on_the_way_ends_the_place_with_closed_fingers(world: World) -> None:
    pick(world, "A")
    skill = skills.place(world, "A", BASE, pointing_down(0.5, 0.1, 0.025, 0.0))
    for count, _ in enumerate(skill):
        if count == 100:
            world.teleport("A", Pose((0.6, -0.1, 0.025), STANDING))
        assert count < 200, "the skill went on without the cube"
        world.step()

    assert world.held is None
    assert world.gripper.state == "closed"
    assert world.pose_in_base("A").position == pytest.approx((0.6, -0.1, 0.025), abs=0.01)


def test_a_halted_skill_leaves_arm_and_fingers_as_they_are(world: World) -> None:
    pick(world, "A")
    world.activity = skills.place(world, "A", BASE, pointing_down(0.5, 0.3, 0.025, 0.0))  # type: ignore[assignment]  # its outcome is not asked for
    world.run(0.6)
    world.halt()
    world.run(0.2)
    stopped = world.arm.tool_pose
    world.run(1.0)

    assert math.dist(world.arm.tool_pose.position, stopped.position) < 0.001
    assert world.held == "A"


def test_a_dropped_cube_falls_into_the_box_and_the_box_takes_it_along(world: World) -> None:
    world.teleport("box", Pose((0.5, -0.3, 0.04), STANDING))
    world.teleport("E", Pose((0.6, 0.1, 0.025), STANDING))
    pick(world, "A")
    assert place(world, "A", 0.5, -0.3, 0.13) == SUCCESS
    world.run(0.5)
    assert world.pose_in_base("A").position[2] < 0.04

    world.teleport("box", Pose((0.5, 0.45, 0.04), (0.0, 0.0, math.sin(0.5), math.cos(0.5))))
    world.run(0.5)

    x, y, _ = world.pose_in_base("box").inverse().apply(world.pose_in_base("A").position)
    assert max(abs(x), abs(y)) < 0.05
    assert world.pose_in_base("A").position == pytest.approx((0.5, 0.45, 0.03), abs=0.03)


def test_a_pushed_cube_moves_and_a_cube_over_an_edge_topples(world: World) -> None:
    world.teleport("D", Pose((0.5, 0.045, 0.075), STANDING))
    world.run(1.0)

    assert world.pose_in_base("D").position[2] < 0.07


@pytest.mark.parametrize("target", [pointing_down(0.95, 0.0, 0.1, 0.0), Pose((0.5, 0.0, 0.1), STANDING)])
def test_a_pose_out_of_reach_is_refused_before_anything_moves(world: World, target: Pose) -> None:
    before = world.arm.tool_pose

    outcome = perform(world, skills.pick(world, "A", BASE, target))

    assert "out of reach" in str(outcome.reason)
    assert math.dist(world.arm.tool_pose.position, before.position) < 0.001


def test_unknown_objects_and_frames_are_named(world: World) -> None:
    with pytest.raises(UnknownObjectError, match="no object 'Z' in this cell; it has A, D, E, F, box"):
        next(skills.pick(world, "Z", BASE, grasp(world, "A")))
    with pytest.raises(UnknownObjectError, match="no frame 'table' in this cell; it has base, A"):
        next(skills.pick(world, "A", "table", grasp(world, "A")))


def test_a_frame_is_taken_as_the_camera_sees_it_at_the_start() -> None:
    with World("object_in_box", np.random.default_rng(3), Noise(0.003, math.radians(1))) as world:
        before = world.frame_in_base("box")
        world.teleport("box", Pose((0.5, 0.3, 0.04), STANDING))
        after = world.frame_in_base("box")

    assert math.dist(before.position, after.position) > 0.05
    assert math.dist(after.position, (0.5, 0.3, 0.04)) < 0.015


def test_the_steps_of_a_scenario_done_by_skills_reach_its_goal_by_truth() -> None:
    scenario = SCENARIOS["hanoi"]
    with World("hanoi", np.random.default_rng(5)) as world:
        for step in scenario.steps:
            assert pick(world, step.object) == SUCCESS
            frame = world.frame_in_base(step.frame)
            hand = pointing_down(*frame.apply(step.at), yaw_of(frame @ Pose((0, 0, 0), (1.0, 0.0, 0.0, 0.0))))
            outcome = perform(world, skills.place(world, step.object, step.frame, frame.inverse() @ hand))
            assert outcome == SUCCESS
            assert not (world.goal.reached and world.held)
        world.run(1.5)

        assert world.goal.reached
        assert world.goal.held_s(world.time_s) > 1.0


def test_the_same_seed_gives_the_same_world_after_the_same_actions() -> None:
    ends = []
    for _ in range(2):
        with World("object_in_box", np.random.default_rng(11)) as world:
            pick(world, "A")
            ends.append(world.poses_in_base())

    assert ends[0] == ends[1]


def test_a_reset_world_stands_at_another_start_with_open_empty_hand(world: World) -> None:
    pick(world, "A")
    world.reset(np.random.default_rng(99))

    assert world.held is None
    assert world.gripper.state == "open"
    assert not world.goal.reached
    assert pick(world, "A") == SUCCESS


@pytest.fixture
def resting() -> Iterator[World]:
    """A on the table, D upon it, E beside; the arm glides, and what lies still sleeps."""
    start = {
        "A": Pose((0.5, 0.0, 0.025)),
        "D": Pose((0.5, 0.0, 0.075)),
        "E": Pose((0.5, -0.2, 0.025)),
        "F": Pose((0.6, 0.35, 0.025)),
        "box": Pose((0.5, -0.5, 0.04)),
    }
    with World("tower_and_box", np.random.default_rng(0), Noise(0.0, 0.0), start, glides=True) as world:
        world.run(1.0)
        assert world.rest
        yield world


def test_what_sleeps_falls_when_what_carried_it_is_taken_away(resting: World) -> None:
    resting.put("A", Pose((0.7, 0.1, 0.025)))
    resting.run(1.0)
    assert resting.pose_in_base("D").position[2] == pytest.approx(0.025, abs=0.002)


def test_what_sleeps_is_met_by_what_is_brought_against_it(resting: World) -> None:
    x, y, _ = resting.pose_in_base("E").position
    assert pick(resting, "D") == SUCCESS
    outcome = place(resting, "D", x, y + 0.03, 0.03)
    assert outcome.failure is not None
    assert (outcome.failure.kind, outcome.failure.with_) == ("contact", "E")
