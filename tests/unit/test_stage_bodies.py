"""The stage: bodies, starts and the hand are read off the demonstrations, wherever and however they were recorded."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS
from experiments.users import REAL
from support_demonstrations import BASE, Put, at, scripted

from learner.execution.ticking import Status, Ticker
from learner.learning import METHODS
from learner.model import Demonstration, ObjectShape, Pose, Scene
from learner.model.pose import multiply
from learner.parameters import Parameters
from learner.rehearsal.stage import Stage
from learner.simulation.kinematic_world import NOISELESS, KinematicWorld

CUBE = ObjectShape((0.05, 0.05, 0.05), "cube")
SCENE = Scene({"A": CUBE, "B": CUBE, "box": ObjectShape((0.3, 0.3, 0.08), "box")})
IN_BOX = (0.05, 0.0, -0.01)
START = {"A": at(0.4, 0.3), "B": at(0.4, -0.4, yaw=0.4), "box": at(0.6, 0.0, z=0.04, yaw=0.3)}


def shown(*puts: Put, start: dict[str, Pose] | None = None, scene: Scene | None = SCENE) -> Demonstration:
    return scripted(start or START, puts, scene=scene)


def elsewhere(demonstration: Demonstration, base: Pose, tool: Pose, markers: dict[str, Pose]) -> Demonstration:
    """The same as a cell records it whose base, end-effector and object frames are others."""

    def seen(name: str, pose: Pose) -> Pose:
        return base @ pose @ markers.get(name, Pose((0.0, 0.0, 0.0)))

    def world(poses: dict[str, Pose]) -> dict[str, Pose]:
        return {name: seen(name, pose) for name, pose in poses.items()}

    actions = []
    for action in demonstration.actions:
        objects, rest = world(dict(action.objects)), action.rest
        if rest is not None:
            there = seen(action.object, rest[BASE])
            rest = {BASE: there, **{f: objects[f].inverse() @ there for f in rest if f != BASE}}
        hand = base @ action.end_effector @ tool
        actions.append(replace(action, end_effector=hand, objects=objects, rest=rest))
    return replace(
        demonstration, actions=tuple(actions), initial=world(dict(demonstration.initial)),
        final=world(dict(demonstration.final)),
    )  # fmt: skip


def test_what_something_came_to_rest_in_is_an_open_box_and_all_else_a_block() -> None:
    stage = Stage([shown(Put("A", "box", IN_BOX))])
    assert {name: body.kind for name, body in stage.bodies.items()} == {"A": "block", "B": "block", "box": "open_box"}
    assert [name for name, body in stage.bodies.items() if body.graspable] == ["A", "B"]


def test_what_something_was_put_upon_is_no_box() -> None:
    stage = Stage([shown(Put("A", "box", (0.0, 0.0, 0.065)))])
    assert stage.bodies["box"].kind == "block"


def test_what_stands_upon_another_is_no_box_for_what_is_below() -> None:
    board = ObjectShape((0.03, 0.03, 0.02))
    start = {**START, "board": at(0.4, 0.3, z=0.01), "A": at(0.4, 0.3, z=0.045)}
    stage = Stage([shown(Put("B", "box", IN_BOX), start=start, scene=Scene({**SCENE.objects, "board": board}))])
    assert stage.bodies["A"].kind == "block"


def test_what_was_picked_can_be_grasped_however_wide_and_so_can_its_like() -> None:
    wide = ObjectShape((0.12, 0.12, 0.05))
    stage = Stage([shown(Put("A", BASE, (0.5, 0.2, 0.025)), scene=Scene({**SCENE.objects, "A": wide, "B": wide}))])
    assert stage.bodies["A"].graspable
    assert stage.bodies["B"].graspable
    assert not stage.bodies["box"].graspable


def test_objects_are_points_where_a_shape_is_not_known() -> None:
    stage = Stage([shown(Put("A", "box", IN_BOX), scene=None)])
    assert stage.points
    world = stage.world(stage.starts[0].spots, np.random.default_rng(0), NOISELESS)
    high = world.spot("A")
    world.table.drop("A", replace(high, x=0.6, y=0.0, z=high.z + 0.2))
    assert world.spot("A").z == pytest.approx(high.z + 0.2)
    assert world.table.on("box") == set()


def test_an_origin_at_the_bottom_of_a_box_is_not_taken_for_its_middle() -> None:
    low = {**START, "box": at(0.6, 0.0, z=0.0, yaw=0.3)}
    stage = Stage([shown(Put("A", "box", (0.05, 0.0, 0.03)), start=low)])
    assert stage.origins_m == pytest.approx({"A": 0.0, "B": 0.0, "box": -0.04}, abs=1e-6)
    assert stage.bodies["box"].kind == "open_box"
    assert stage.starts[0].spots["box"].z == pytest.approx(0.04)
    assert stage.point("box", (0.05, 0.0, 0.03)) == pytest.approx((0.05, 0.0, -0.01))


def test_a_demonstration_that_the_stage_does_not_reproduce_is_left_out_with_the_reason() -> None:
    floating = shown(Put("A", BASE, (0.5, 0.2, 0.3)))
    stage = Stage([replace(shown(Put("A", "box", IN_BOX)), demonstration_id="good"), floating])
    assert [start.demonstration_id for start in stage.starts] == ["good"]
    assert stage.left_out == {"d1": "A would not stay where it came to rest"}


def test_an_object_that_lies_on_another_face_than_usual_is_no_start() -> None:
    over = Pose(START["B"].position, (math.sin(math.pi / 4), 0.0, 0.0, math.cos(math.pi / 4)))
    usual = [replace(shown(Put("A", "box", IN_BOX)), demonstration_id=f"u{n}") for n in range(2)]
    stage = Stage([*usual, shown(Put("A", "box", IN_BOX), start={**START, "B": over})])
    assert stage.left_out == {"d1": "B lies on another face than in the others"}


def shown_elsewhere(turn: np.ndarray, flange_m: float) -> list[Demonstration]:
    """A table 20 cm up and a metre away, markers on other faces, a flange above the fingertips for an end-effector."""
    scenario = SCENARIOS["tower_and_box"]
    flange = Pose.of((0.0, 0.0, -flange_m), multiply(np.array([0.0, 0.0, math.sin(0.3), math.cos(0.3)]), turn))
    markers = {name: Pose.of((0.0, 0.0, 0.0), turn) for name in scenario.objects}
    others = [elsewhere(shown, Pose((1.5, 2.0, 0.2)), flange, markers) for shown in demonstrated(scenario, 3, 7)]
    return sorted((replace(d, scene=_turned(d.scene, turn)) for d in others), key=lambda d: d.demonstration_id)


def run_on(stage: Stage, demonstrations: list[Demonstration]) -> KinematicWorld:
    """The world after the tree of the demonstrations has run in it for 200 steps at most."""
    tree = METHODS["treewright"](demonstrations, Parameters()).tree
    world = stage.world(stage.starts[0].spots, np.random.default_rng(1))
    ticker = Ticker(stage.root(tree.flattened()), world)
    for _ in range(200):
        if ticker.tick() is Status.SUCCESS:
            break
        world.step()
    return world


def test_an_end_effector_too_far_from_what_it_grasps_is_found_out_on_the_stage() -> None:
    """No cell believes by CONTRACT, section 3, that such a hand holds anything: 7.5 cm from a cube's side."""
    others = shown_elsewhere(np.array([1.0, 0.0, 0.0, 0.0]), 0.10)
    world = run_on(Stage(others), others)
    given_up = [attempt for attempt in world.attempts if not attempt.ended]
    assert len(given_up) > 6, "six actions would do, were it known that something is held"


@pytest.mark.parametrize("marker", [(1.0, 0.0, 0.0, 0.0), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))])
def test_a_tree_of_a_cell_with_other_frames_runs_on_the_stage(marker: tuple[float, float, float, float]) -> None:
    others = shown_elsewhere(np.array(marker), 0.06)
    stage = Stage(others)
    assert stage.left_out == {}
    assert stage.bodies["box"].kind == "open_box"
    assert stage.bodies["box"].shape.size_m == pytest.approx((0.3, 0.3, 0.08))
    world = run_on(stage, others)
    assert SCENARIOS["tower_and_box"].reached(world.table.spots, world.held)
    assert len(world.attempts) == 6


def _turned(scene: Scene | None, turn: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Scene:
    """The scene whose sizes are along the axes of turned markers."""
    assert scene is not None
    from learner.model.pose import conjugate, rotate

    def size(shape: ObjectShape) -> ObjectShape:
        x, y, z = np.abs(rotate(conjugate(turn), np.array(shape.size_m))).tolist()
        return ObjectShape((x, y, z), shape.symmetry)

    return Scene({name: size(shape) for name, shape in scene.objects.items()}, None)


def test_crooked_markers_and_quarter_turns_do_not_hide_the_hand() -> None:
    stage = Stage(demonstrated(SCENARIOS["towers"], 3, 1001, (REAL,)))
    assert np.linalg.norm(stage.tip.position) < 0.01
    assert 2 * math.acos(min(1.0, abs(stage.tip.quaternion_xyzw[3]))) < math.radians(6)
    assert stage.shift[2] == pytest.approx(0.0, abs=0.003)


def test_a_stage_that_is_shifted_takes_its_workspace_along() -> None:
    far = {**START, "A": at(3.0, 2.0)}
    stage = Stage([shown(Put("A", "box", IN_BOX), start=far)])
    moved = stage.moved(0.5, -0.25)
    (_, x1), (_, y1) = stage.workspace_m
    (_, a1), (_, b1) = moved.workspace_m
    seen = stage.starts[0].spots["A"]
    assert moved.world(moved.starts[0].spots, np.random.default_rng(0)).reaches((seen.x + 0.5, seen.y - 0.25, 0.1))
    assert (a1 - x1, b1 - y1) == pytest.approx((0.5, -0.25))
