"""The physical world keeps CONTRACT, section 3, as the kinematic one does, and tells the truth of its physics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import numpy as np
import pytest

from learner.execution.ticking import Status, Ticker
from learner.model import (
    Definition,
    Drop,
    GripperIs,
    InGripper,
    ObjectAt,
    ObjectShape,
    Pick,
    Place,
    Pose,
    SetGripper,
    Tree,
)
from learner.model.condition import DROP_RADIUS_M
from learner.model.tree import Node, fallback, leaf, sequence
from learner.model.upright import Spot
from learner.simulation.arena import Arena
from learner.simulation.cell import skills
from learner.simulation.cell.arm_kinematics import inverse, pointing_down, reaches
from learner.simulation.cell.bodies import upright
from learner.simulation.cell.physics import World
from learner.simulation.failure import Failure
from learner.simulation.gravity import Body
from learner.simulation.kinematic_world import NOISELESS, Behavior, KinematicWorld
from learner.simulation.physical_world import PhysicalWorld
from learner.simulation.scenarios import SCENARIOS

CUBE = Body(ObjectShape((0.05, 0.05, 0.05), "cube"))
BOX = Body(ObjectShape((0.3, 0.3, 0.08), "box"), "open_box")
DOWN = (1.0, 0.0, 0.0, 0.0)
ORIGIN = (0.0, 0.0, 0.0)
ON_TOP = (0.0, 0.0, 0.05)
OPEN = leaf(GripperIs("open"))
SPOTS = {
    "A": Spot(0.45, 0.1, 0.025, 0.3),
    "B": Spot(0.6, -0.2, 0.025, -0.4),
    "C": Spot(0.4, 0.35, 0.025, 1.0),
    "box": Spot(0.45, -0.45, 0.04, 0.2),
}
Make = Callable[..., Arena]


@pytest.fixture
def physical() -> Iterator[Callable[..., PhysicalWorld]]:
    with ExitStack() as stack:

        def make(behavior: Behavior | None = None, **spots: Spot) -> PhysicalWorld:
            placed = spots or SPOTS
            rng = np.random.default_rng(1)
            return stack.enter_context(PhysicalWorld(bodies(placed), placed, rng, NOISELESS, behavior=behavior))

        yield make


@pytest.fixture(params=["kinematic", "physical"])
def arena(request: pytest.FixtureRequest, physical: Make) -> Make:
    def kinematic(behavior: Behavior | None = None, **spots: Spot) -> Arena:
        placed = spots or SPOTS
        rng = np.random.default_rng(1)
        return KinematicWorld(bodies(placed), placed, rng, NOISELESS, behavior=behavior or Behavior())

    return physical if request.param == "physical" else kinematic


def bodies(spots: dict[str, Spot]) -> dict[str, Body]:
    return {name: BOX if name == "box" else CUBE for name in spots}


def pick(name: str) -> Node:
    return leaf(Pick(name, name, ORIGIN, DOWN))


def stack(upper: str, lower: str) -> Node:
    return leaf(Place(upper, lower, ON_TOP, DOWN, ON_TOP))


def do(world: Arena, *actions: Node) -> list[Status]:
    """Run actions one after the other, each until it ends."""
    return [_end(world, node) for node in actions]


def _end(world: Arena, node: Node) -> Status:
    for _ in range(300):
        status = world.tick_action(node)
        if status is not Status.RUNNING:
            return status
        world.step()
    raise AssertionError(f"{node.kind} never ends")


def test_actions_and_conditions_mean_the_same_in_both_worlds(arena: Make) -> None:
    world = arena()
    assert do(world, pick("A"), stack("A", "B")) == [Status.SUCCESS] * 2
    world.step()
    assert world.check(leaf(ObjectAt("A", "B", ON_TOP, 0.01)))
    assert world.table.on("B") == {"A"}
    assert world.held is None
    assert world.faults.contacts == 0
    assert [attempt.failure for attempt in world.attempts] == [None, None]


def test_a_tree_builds_a_tower_and_fills_the_box_in_both_worlds(arena: Make) -> None:
    world = arena()
    over_box = leaf(Drop("C", "box", (0.0, 0.0, 0.1), DOWN, (0.0, 0.0, 0.1), DROP_RADIUS_M))

    def step(release: Node, done: ObjectAt, name: str) -> Node:
        emptied = fallback(OPEN, leaf(SetGripper("open")))
        return fallback(leaf(done), sequence(fallback(leaf(InGripper(name)), sequence(emptied, pick(name))), release))

    boxed = step(over_box, ObjectAt("C", "box", (0.0, 0.0, -0.01), 0.05), "C")
    root = sequence(step(stack("A", "B"), ObjectAt("A", "B", ON_TOP, 0.02), "A"), boxed)
    ticker = Ticker(Tree(Definition("task", root)).flattened(), world)
    for _ in range(600):
        if ticker.tick() is Status.SUCCESS:
            break
        world.step()

    assert world.table.on("B") == {"A"}
    assert world.table.on("box") == {"C"}
    assert len(world.attempts) == 4


def test_gripper_conditions_keep_their_values_while_an_action_runs(arena: Make) -> None:
    world, node = arena(), pick("A")
    status = world.tick_action(node)
    while status is Status.RUNNING:
        assert world.check(OPEN)
        assert world.check(leaf(InGripper("none")))
        world.step()
        status = world.tick_action(node)
    assert status is Status.SUCCESS
    assert world.check(leaf(InGripper("A")))
    assert not world.check(OPEN)
    assert not world.check(leaf(ObjectAt("A", "A", ORIGIN)))


def test_a_covered_cube_is_not_picked_and_the_contact_counts(arena: Make) -> None:
    world = arena(A=SPOTS["A"], D=Spot(SPOTS["A"].x, SPOTS["A"].y, 0.075, 0.3))
    assert do(world, pick("A")) == [Status.FAILURE]
    assert world.faults.contacts == 1
    assert str(world.attempts[-1].failure).startswith("contact with D")
    assert world.held is None


def test_what_is_out_of_reach_fails(arena: Make) -> None:
    world = arena()
    assert do(world, leaf(Pick("A", "base", (1.4, 0.0, 0.025), DOWN))) == [Status.FAILURE]
    assert "out of reach" in str(world.attempts[-1].failure)


def test_a_halted_action_stops_the_arm_and_leaves_the_fingers(physical: Callable[..., PhysicalWorld]) -> None:
    world, node = physical(), stack("A", "B")
    do(world, pick("A"))
    for _ in range(8):
        world.tick_action(node)
        world.step()
    world.halt_action(node)
    world.step()
    stopped = world.hand
    for _ in range(10):
        world.step()
    assert math.dist(world.hand, stopped) < 1e-3
    assert world.held == "A"
    assert world.check(leaf(InGripper("A")))


def test_an_action_started_while_another_runs_survives_the_halt_of_the_first(arena: Make) -> None:
    world, first, second = arena(), pick("A"), pick("B")
    world.tick_action(first)
    world.step()
    world.tick_action(second)
    world.halt_action(first)
    assert do(world, second) == [Status.SUCCESS]
    assert world.held == "B"


def test_what_a_human_takes_away_is_not_held_any_more_and_may_be_given_back(arena: Make) -> None:
    world = arena()
    do(world, pick("A"))
    memory = world.remember()
    world.take_away(Spot(0.4, -0.1, 0.0, 0.0))
    assert world.held is None
    assert world.table.spots["A"].z == pytest.approx(0.025, abs=0.003)

    world.recall(memory)
    assert world.held == "A"
    assert do(world, stack("A", "B")) == [Status.SUCCESS]

    do(world, pick("C"))
    world.take_away(Spot(0.4, -0.1, 0.0, 0.0))
    for _ in range(5):
        world.step()
    assert not world.check(leaf(InGripper("C")))
    assert world.check(leaf(GripperIs("closed")))


def test_a_place_that_loses_its_object_fails(arena: Make) -> None:
    world, node = arena(), stack("A", "B")
    do(world, pick("A"))
    world.tick_action(node)
    world.step()
    world.take_away(Spot(0.4, -0.1, 0.0, 0.0))
    assert do(world, node) == [Status.FAILURE]


def test_a_human_lays_things_upon_each_other_and_moves_them_together(arena: Make) -> None:
    world = arena()
    world.lay("A", world.spot("B"))
    world.lay("C", world.spot("box"))
    assert world.table.on("B") == {"A"}
    assert world.table.on("box") == {"C"}

    world.carry("B", Spot(0.5, 0.2, 0.025, 0.7))
    world.carry("box", Spot(0.5, -0.3, 0.04, -0.5))
    assert world.table.on("B") == {"A"}
    assert world.table.on("box") == {"C"}
    assert math.dist(astuple(world.spot("B"))[:2], (0.5, 0.2)) < 0.005


def astuple(spot: Spot) -> tuple[float, float, float]:
    return spot.x, spot.y, spot.z


def test_pulling_a_cube_out_lets_what_stood_on_it_fall(arena: Make) -> None:
    world = arena()
    world.lay("A", world.spot("B"))
    world.lay("B", Spot(0.4, -0.1, 0.0, 0.0))
    assert world.spot("A").z == pytest.approx(0.025, abs=0.003)


def test_what_is_put_into_the_hand_is_noticed(physical: Callable[..., PhysicalWorld]) -> None:
    world = physical()
    do(world, pick("A"))
    world.step()
    x, y, _ = world.hand
    memory = world.remember()
    world.lay("C", Spot(0.3, 0.45, 0.0, 0.0))
    assert world.hand_is_clear()
    high = world.hand[2] - 0.05
    world.carry("B", Spot(x, y, high, 0.0))
    assert not world.hand_is_clear()
    world.recall(memory)
    assert world.hand_is_clear()
    assert world.held == "A"
    assert math.dist(astuple(world.spot("C")), astuple(SPOTS["C"])) < 0.003


def test_skills_fail_as_often_as_told(physical: Callable[..., PhysicalWorld]) -> None:
    world = physical(Behavior(failing=1.0))
    assert do(world, pick("A")) == [Status.FAILURE]
    assert world.attempts[-1].failure == Failure("random")
    assert world.held is None
    assert do(world, leaf(SetGripper("closed"))) == [Status.SUCCESS]


def test_the_same_seed_gives_the_same_run(physical: Callable[..., PhysicalWorld]) -> None:
    ends = []
    for _ in range(2):
        world = physical()
        do(world, pick("A"), stack("A", "B"))
        ends.append((world.steps, world.table.spots))
    assert ends[0] == ends[1]


@pytest.mark.parametrize("upper", ["D", "A"])
def test_an_arm_that_glides_does_what_an_arm_that_drives_does(upper: str) -> None:
    ends, steps = [], []
    for glides in (False, True):
        with World("tower_and_box", np.random.default_rng(3), glides=glides, looks=1) as world:
            grasp, lower = world.pose_in_base(upper), world.pose_in_base("E")
            above = Pose((*lower.position[:2], 0.075), grasp.quaternion_xyzw)
            for skill, at in ((skills.pick, grasp), (skills.place, above)):
                world.activity = skill(world, upper, "base", at @ Pose(ORIGIN, DOWN))  # type: ignore[assignment]  # its outcome is not asked for
                count = 0
                while world.activity is not None:
                    world.step()
                    count += 1
            world.run(0.5)
            ends.append(world.poses_in_base())
            steps.append(count)

    for name, pose in ends[0].items():
        assert math.dist(pose.position, ends[1][name].position) < 0.002
    assert ends[0][upper].position[2] == pytest.approx(0.075, abs=0.003)
    assert steps[1] < steps[0] / 2


def test_a_cube_on_any_side_looks_as_if_it_stood() -> None:
    rng = np.random.default_rng(0)
    half = math.sqrt(0.5)
    for turn in ((half, 0, 0, half), (0, half, 0, half), (1.0, 0, 0, 0), (-half, 0, 0, half), (0, -half, 0, half)):
        standing = Pose((0.4, 0.0, 0.025), (0.0, 0.0, *rng.standard_normal(2)))
        assert upright(standing) == standing
        shown = upright(standing @ Pose(ORIGIN, turn))
        assert shown.apply((0.0, 0.0, 1.0))[2] - shown.position[2] == pytest.approx(1.0)
        yaw = Spot.of(shown).yaw - Spot.of(standing).yaw
        assert math.remainder(yaw, math.pi / 2) == pytest.approx(0.0, abs=1e-9)


def test_what_is_said_to_be_in_reach_is_in_reach() -> None:
    rng = np.random.default_rng(0)
    for x, y, z, yaw in rng.uniform((-0.8, -0.8, 0.02, -3.1), (0.8, 0.8, 0.3, 3.1), (400, 4)):
        if reaches(x, y):
            assert inverse(pointing_down(x, y, z, yaw)) is not None, (x, y, z)


def test_the_scenarios_of_the_cell_keep_their_starts_without_gliding() -> None:
    for name in SCENARIOS:
        with World(name, np.random.default_rng(0)) as world:
            assert not world.gliding.wanted
            assert not world.goal.reached
