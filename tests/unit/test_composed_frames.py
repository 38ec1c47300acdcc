"""Frames that go by two objects or by the base's axes: one meaning in tables, cells and worlds; learned, and run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import pytest
from hypothesis import given
from support_demonstrations import BASE, POSES, TABLE_M, Put, scattered, scripted

from learner.errors import ModelError
from learner.execution.perception import CellState
from learner.learning import learn
from learner.model import Demonstration, ObjectAt, ObjectShape, Pose, Scene, Tree
from learner.model.frame import between, is_composed, midway, objects_of, on_axes, pose_of, upright
from learner.model.poses import Poses
from learner.model.tree import Definition, leaf
from learner.model.upright import Spot, spot_of
from storage.btcpp import from_xml, to_xml
from storage.errors import WrittenTreeError

PART = ObjectShape((0.05, 0.05, 0.05), "cube")


@given(POSES, POSES)
def test_one_pose_and_many_mean_the_same(a: Pose, b: Pose) -> None:
    poses = {"A": a, "B": b}
    for frame, many in (
        ("A+B", midway(Poses.of([a]), Poses.of([b]))),
        ("A@axes", upright(Poses.of([a]))),
        ("A", Poses.of([a])),
    ):
        one = pose_of(frame, poses.__getitem__)
        assert np.allclose(one.position, many.positions[0])
        assert np.allclose(one.quaternion_xyzw, many.quaternions_xyzw[0])


def test_between_two_objects_x_points_from_the_first_to_the_second_and_z_up() -> None:
    poses = {"A": Pose((1.0, 1.0, 0.1), (0.6, 0.0, 0.0, 0.8)), "B": Pose((1.0, 3.0, 0.3))}
    frame = pose_of(between("A", "B"), poses.__getitem__)
    assert np.allclose(frame.position, (1.0, 2.0, 0.2))
    assert np.allclose(frame.apply((0.5, 0.0, 0.1)), (1.0, 2.5, 0.3))
    assert np.allclose(pose_of(on_axes("A"), poses.__getitem__).apply((0.5, 0.0, 0.0)), (1.5, 1.0, 0.1))


def test_a_frame_is_told_by_its_objects() -> None:
    assert [objects_of(frame) for frame in ("A", "A+B", "A@axes", "A@start")] == [("A",), ("A", "B"), ("A",), ("A",)]
    assert [is_composed(frame) for frame in ("A", "base", "A+B", "A@axes", "A@start")] == [False, False, *[True] * 3]


def test_a_spot_between_two_spots_turns_with_them() -> None:
    spots = {"A": Spot(0.0, 0.0, 0.0, 1.0), "B": Spot(0.0, 2.0, 0.0, -1.0)}
    found = spot_of("A+B", spots)
    assert (found.x, found.y, found.yaw) == pytest.approx((0.0, 1.0, math.pi / 2))


def test_a_cell_judges_a_place_between_two_objects_and_needs_to_see_both() -> None:
    state = CellState("base", "tool0")
    for name, position in (("A", (0.0, 0.0, 0.0)), ("B", (0.0, 2.0, 0.0)), ("C", (0.0, 1.0, 0.0))):
        state.update_pose(name, 1, Pose(position))
    condition = ObjectAt("C", "A+B", (0.0, 0.0, 0.0), 0.05)
    assert state.holds(condition)
    state.update_pose("A", 2, Pose((1.0, 0.0, 0.0)))
    assert not state.holds(condition)
    assert state.unseen("A+X")
    assert state.pose("A+X") is None


@pytest.mark.parametrize("frame", ["A+", "+B", "A+A", "A+B+C", "A+b b", "@axes", "A@end"])
def test_a_tree_with_a_frame_that_goes_by_nothing_is_refused(frame: str) -> None:
    condition = leaf(ObjectAt("C", frame, (0.0, 0.0, 0.0), 0.05))
    with pytest.raises(WrittenTreeError, match="frame"):
        from_xml(to_xml(Tree(Definition("Main", condition))))


def test_how_things_stood_at_the_beginning_is_not_guessed() -> None:
    with pytest.raises(ModelError, match="how things stood at the beginning"):
        pose_of("A@start", {"A": Pose((0.0, 0.0, 0.0))}.__getitem__)


def shown(make: Callable[[Mapping[str, Pose]], tuple[float, float]], count: int = 4) -> list[Demonstration]:
    rng, found = np.random.default_rng(6), []
    scene = Scene(dict.fromkeys("ABC", PART), ((0.15, 0.85), (-0.55, 0.55)))
    for number in range(count):
        start = scattered("ABC", rng)
        x, y = make(start)
        turned = float(rng.uniform(-3, 3))
        script = [Put("B", BASE, (x, y, TABLE_M), yaw=turned)]
        found.append(scripted(start, script, f"d{number}", rng=rng, scene=scene))
    return found


def halfway(start: Mapping[str, Pose]) -> tuple[float, float]:
    (x0, y0, _), (x1, y1, _) = start["A"].position, start["C"].position
    return (x0 + x1) / 2, (y0 + y1) / 2


def ahead(start: Mapping[str, Pose]) -> tuple[float, float]:
    return start["A"].position[0] + 0.12, start["A"].position[1]


@pytest.mark.parametrize(("make", "frame"), [(halfway, "A+C"), (ahead, "A@axes")])
def test_a_task_told_by_such_a_frame_is_learned_rehearsed_and_replayed(
    make: Callable[[Mapping[str, Pose]], tuple[float, float]], frame: str
) -> None:
    learned = learn(shown(make), rehearsed=True)
    assert [(action["object"], action["frame"]) for action in learned.report["actions"]] == [("B", frame)]
    assert learned.tree.vocabulary == 2
    rehearsal, replay = learned.report["rehearsal"], learned.report["replay"]
    assert rehearsal["done"] >= 0.95 * rehearsal["rollouts"] > 20
    assert "done" in [run["verdict"] for run in replay["runs"]]
    assert learned.certificate is not None
    assert learned.certificate["left_out"] == "that frames which go by several objects move with them"
    assert learned.certificate["counterexample"] is None
    assert from_xml(to_xml(learned.tree)) == learned.tree
    assert learned.doubts == ()
