"""The kinematic world keeps CONTRACT, section 3."""

from __future__ import annotations

import math

import numpy as np
import pytest

from learner.errors import LearnerError
from learner.execution.ticking import Status, Ticker
from learner.model import Drop, GripperIs, InGripper, ObjectAt, ObjectRoughlyAt, ObjectShape, Pick, Place, SetGripper
from learner.model.pose import Pose
from learner.model.tree import Node, asked, leaf, sequence
from learner.model.upright import Spot
from learner.relations.grasping import Grasp
from learner.relations.knowledge import Knowledge
from learner.simulation.gravity import Body
from learner.simulation.kinematic_world import NOISELESS, Behavior, KinematicWorld, Noise

CUBE = Body(ObjectShape((0.05, 0.05, 0.05), "cube"))
BOX = Body(ObjectShape((0.3, 0.3, 0.08), "box"), "open_box")
DOWN = (1.0, 0.0, 0.0, 0.0)
ORIGIN = (0.0, 0.0, 0.0)
OPEN, CLOSED = leaf(GripperIs("open")), leaf(GripperIs("closed"))
ON_TOP = (0.0, 0.0, 0.05)


def world(noise: Noise = NOISELESS, behavior: Behavior | None = None, **spots: Spot) -> KinematicWorld:
    bodies = {name: BOX if name == "box" else CUBE for name in spots}
    return KinematicWorld(bodies, spots, np.random.default_rng(1), noise, behavior=behavior or Behavior())


def pick(name: str, position: tuple[float, float, float] = ORIGIN) -> Node:
    return leaf(Pick(name, name, position, DOWN))


def do(cell: KinematicWorld, *actions: Node) -> list[Status]:
    """Run actions one after the other, each until it ends."""
    ends = []
    for node in actions:
        status = cell.tick_action(node)
        for _ in range(20):
            if status is not Status.RUNNING:
                break
            cell.step()
            status = cell.tick_action(node)
        ends.append(status)
    return ends


def two() -> KinematicWorld:
    return world(A=Spot(0.4, 0.1, 0.025, 0.3), B=Spot(0.6, -0.2, 0.025, -0.4))


def test_pick_and_place_puts_one_cube_on_another() -> None:
    cell = two()
    place = leaf(Place("A", "B", ON_TOP, DOWN, ON_TOP))
    assert do(cell, pick("A"), place) == [Status.SUCCESS] * 2
    assert cell.check(leaf(ObjectAt("A", "B", ON_TOP)))
    assert cell.table.on("B") == {"A"}
    assert cell.held is None
    assert cell.faults.contacts == 0


def test_a_pick_fails_at_once_with_a_closed_gripper() -> None:
    cell = two()
    do(cell, leaf(SetGripper("closed")))
    assert cell.tick_action(pick("A")) is Status.FAILURE


def test_a_pick_beside_the_object_fails_with_closed_fingers() -> None:
    cell = two()
    assert do(cell, pick("A", (0.02, 0.0, 0.0))) == [Status.FAILURE]
    assert cell.check(CLOSED)
    assert cell.check(leaf(InGripper("none")))


@pytest.mark.parametrize(("turn_deg", "holds"), [(10, True), (90, True), (100, True), (30, False), (45, False)])
def test_a_grasp_holds_within_fifteen_degrees_of_a_quarter_turn(turn_deg: float, holds: bool) -> None:
    cell = two()
    yaw = math.radians(turn_deg)
    do(cell, leaf(Pick("A", "A", ORIGIN, (math.cos(yaw / 2), math.sin(yaw / 2), 0.0, 0.0))))
    assert (cell.held == "A") is holds


def test_picking_a_covered_cube_is_a_contact_and_moves_nothing() -> None:
    cell = world(A=Spot(0.4, 0.1, 0.025, 0.0), B=Spot(0.4, 0.1, 0.075, 0.0))
    before = dict(cell.table.spots)
    assert do(cell, pick("A")) == [Status.FAILURE]
    assert cell.faults.contacts == 1
    assert cell.table.spots == before
    assert cell.check(OPEN)


def test_picking_a_cube_that_carries_half_of_another_makes_that_one_fall() -> None:
    cell = world(A=Spot(0.4, 0.0, 0.025, 0.0), B=Spot(0.4, 0.08, 0.025, 0.0), C=Spot(0.4, 0.04, 0.075, 0.0))
    assert do(cell, pick("B")) == [Status.SUCCESS]
    assert cell.faults.contacts == 1
    assert cell.held == "B"
    assert cell.spot("C").z == pytest.approx(0.025)


def test_placing_where_something_stands_is_a_contact_and_keeps_hold() -> None:
    cell = world(A=Spot(0.4, 0.1, 0.025, 0.0), B=Spot(0.6, 0.1, 0.025, 0.0))
    occupied = (0.62, 0.1, 0.025)
    assert do(cell, pick("A"), leaf(Place("A", "base", occupied, DOWN, occupied))) == [Status.SUCCESS, Status.FAILURE]
    assert cell.held == "A"
    assert cell.check(leaf(InGripper("A")))
    assert cell.faults.contacts == 1


def test_gripper_and_held_object_keep_their_values_while_an_action_runs() -> None:
    cell = two()
    node = pick("A")
    cell.tick_action(node)
    while cell.held is None:
        cell.step()
    assert cell.tick_action(node) is Status.RUNNING
    assert cell.check(OPEN)
    assert cell.check(leaf(InGripper("none")))
    do(cell, node)
    assert cell.check(CLOSED)
    assert cell.check(leaf(InGripper("A")))


def test_a_halted_place_stops_and_keeps_hold() -> None:
    cell = two()
    do(cell, pick("A"))
    place = leaf(Place("A", "B", ON_TOP, DOWN, ON_TOP))
    cell.tick_action(place)
    cell.step()
    cell.halt_action(place)
    where = cell.hand
    for _ in range(10):
        cell.step()
    assert cell.hand == where
    assert cell.held == "A"
    do(cell, leaf(SetGripper("open")))
    assert cell.spot("A").z == pytest.approx(0.025)


def test_an_action_started_before_the_old_one_is_halted_goes_on() -> None:
    cell = two()
    old, new = pick("A"), pick("B")
    cell.tick_action(old)
    cell.step()
    cell.tick_action(new)
    cell.halt_action(old)
    assert do(cell, new) == [Status.SUCCESS]
    assert cell.held == "B"


def test_a_held_object_is_nowhere() -> None:
    cell = two()
    at_start = leaf(ObjectAt("A", "base", (0.4, 0.1, 0.025), 0.05))
    assert cell.check(at_start)
    do(cell, pick("A"))
    assert not cell.check(leaf(ObjectRoughlyAt("A", "base", (0.4, 0.1, 0.025), 0.1)))


def test_an_object_pulled_from_the_fingers_is_noticed_and_the_place_fails() -> None:
    cell = two()
    do(cell, pick("A"))
    cell.take_away(Spot(0.8, 0.5, 0.0, 0.0))
    seen = []
    for _ in range(3):
        cell.step()
        seen.append(cell.check(leaf(InGripper("none"))))
    assert seen == [False, False, True], "one look is no proof, CONTRACT has the same rule for cells"
    assert cell.check(CLOSED)
    assert do(cell, leaf(Place("A", "B", ON_TOP, DOWN, ON_TOP))) == [Status.FAILURE]


def test_roughly_at_ignores_height_and_at_does_not() -> None:
    cell = two()
    above = (0.42, 0.1, 0.5)
    assert cell.check(leaf(ObjectRoughlyAt("A", "base", above)))
    assert not cell.check(leaf(ObjectAt("A", "base", above)))


def test_a_drop_into_a_box_rests_inside() -> None:
    cell = world(A=Spot(0.4, 0.4, 0.025, 0.3), box=Spot(0.5, -0.2, 0.04, 1.0))
    over = (0.0, 0.0, 0.1)
    assert do(cell, pick("A"), leaf(Drop("A", "box", over, DOWN, over))) == [Status.SUCCESS] * 2
    assert cell.check(leaf(ObjectRoughlyAt("A", "box", over)))
    assert cell.spot("A").z == pytest.approx(0.03)


def test_a_target_out_of_reach_fails() -> None:
    cell = two()
    assert do(cell, leaf(Pick("A", "base", (2.0, 0.0, 0.1), DOWN))) == [Status.FAILURE]


def test_the_camera_says_the_same_until_the_next_step_and_is_noisy() -> None:
    cell = world(Noise(), A=Spot(0.4, 0.1, 0.025, 0.3))
    seen = []
    for _ in range(400):
        assert cell.see("A") is cell.see("A")
        seen.append(cell.see("A")[0])
        cell.step()
    assert np.std(seen, axis=0) == pytest.approx([0.003] * 3, rel=0.2)


def test_failing_skills_fail_about_as_often_as_told() -> None:
    cell = world(NOISELESS, Behavior(failing=0.2), A=Spot(0.4, 0.1, 0.025, 0.3))
    failures = 0
    for _ in range(200):
        failures += do(cell, pick("A"))[0] is Status.FAILURE
        do(cell, leaf(SetGripper("open")))
    assert 20 < failures < 65
    assert cell.faults.contacts == 0


def test_noise_hardly_ever_breaks_a_grasp() -> None:
    failures = 0
    for seed in range(150):
        cell = KinematicWorld({"A": CUBE}, {"A": Spot(0.4, 0.1, 0.025, 0.3)}, np.random.default_rng(seed))
        failures += do(cell, pick("A"))[0] is Status.FAILURE
    assert failures < 15


def test_an_unknown_object_is_named() -> None:
    with pytest.raises(LearnerError, match="'Z'"):
        two().check(leaf(ObjectAt("Z", "base", ORIGIN)))


def test_a_sequence_of_pick_and_place_runs_under_the_ticker() -> None:
    cell = two()
    ticker = Ticker(sequence(pick("A"), leaf(Place("A", "B", ON_TOP, DOWN, ON_TOP)), reactive=False), cell)
    for _ in range(30):
        if ticker.tick() is Status.SUCCESS:
            break
        cell.step()
    assert cell.table.on("B") == {"A"}


def test_with_a_closed_gripper_no_grasp_is_tried_and_one_that_holds_nothing_is() -> None:
    grasp, asks = (
        Grasp(Pose(ORIGIN, DOWN), object="A"),
        asked("FindGrasp", object="A", position="{p}", orientation="{q}"),
    )
    cell = KinematicWorld({"A": CUBE}, {"A": Spot(0.4, 0.1, 0.025, 0.3)}, np.random.default_rng(1), NOISELESS,
                          knowledge=Knowledge((grasp,)))  # fmt: skip
    assert do(cell, leaf(SetGripper("closed")), pick("A"), leaf(SetGripper("open")))[1] is Status.FAILURE
    assert cell.find(asks) is not None
    cell.behavior = Behavior(failing=1.0)
    assert do(cell, pick("A")) == [Status.FAILURE]
    assert cell.find(asks) is None
