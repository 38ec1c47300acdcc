"""Orientation: learned where it matters, up to an object's symmetry, and asked for by cells and worlds alike."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support_demonstrations import Put, scattered, scripted

from learner.execution.perception import CellState
from learner.execution.ticking import Status, Ticker
from learner.learned import Learned
from learner.learning import learn
from learner.model import Demonstration, ObjectShape, Pose, Scene
from learner.model.condition import ObjectPosedAt
from learner.model.pose import Quaternion
from learner.model.scene import Symmetry
from learner.model.tree import Definition, Tree, leaf
from learner.model.turning import SAME, turned_rad
from learner.rehearsal.stage import Stage
from learner.relations.answering import Answering
from storage.btcpp import from_xml, to_xml

TRAY = ObjectShape((0.25, 0.12, 0.02), "none")


def about_z(angle_rad: float) -> Quaternion:
    return (0.0, 0.0, math.sin(angle_rad / 2), math.cos(angle_rad / 2))


@pytest.mark.parametrize(
    ("symmetry", "degrees", "left"),
    [
        ("none", 180, 180), ("none", 90, 90), ("box", 180, 0), ("box", 90, 90), ("cube", 90, 0), ("cube", 45, 45),
        ("cube", 100, 10), ("vertical", 77, 0), ("none", 10, 10),
    ],
)  # fmt: skip
def test_turns_that_look_the_same_count_for_nothing(symmetry: Symmetry, degrees: float, left: float) -> None:
    found = turned_rad(about_z(0.3 + math.radians(degrees)), about_z(0.3), symmetry)
    assert math.degrees(found) == pytest.approx(left, abs=1e-5)


def test_a_cube_has_24_turns_and_a_vertical_one_may_not_tip() -> None:
    assert len({tuple(np.round(q * np.sign(q[np.argmax(np.abs(q) > 1e-9)]), 6)) for q in SAME["cube"]}) == 24
    tipped = (math.sin(0.2), 0.0, 0.0, math.cos(0.2))
    assert turned_rad(tipped, (0.0, 0.0, 0.0, 1.0), "vertical") == pytest.approx(0.4)


def shown(symmetry: Symmetry, cared: bool, count: int = 4, begun_alike: bool = False) -> list[Demonstration]:
    rng, found = np.random.default_rng(2), []
    scene = Scene({"B": ObjectShape((0.08, 0.04, 0.04), symmetry), "tray": TRAY}, ((0.15, 0.85), (-0.55, 0.55)))
    for number in range(count):
        start = scattered(["B", "tray"], rng)
        if begun_alike:
            x, y, z = start["B"].position
            start["B"] = Pose((x, y, z), start["tray"].quaternion_xyzw)
        yaw = 0.7 if cared else float(rng.uniform(-3, 3))
        yaw = 0.0 if begun_alike else yaw
        found.append(scripted(start, [Put("B", "tray", (0.0, 0.0, 0.03), yaw=yaw)], f"d{number}", rng=rng, scene=scene))
    return found


def posed(learned: Learned) -> list[ObjectPosedAt]:
    words = [node.word for node in learned.tree.flattened().walk() if node.kind == "ObjectPosedAt"]
    return list(dict.fromkeys(word for word in words if isinstance(word, ObjectPosedAt)))


@pytest.mark.parametrize("symmetry", ["none", "box"])
def test_an_orientation_that_was_the_same_each_time_is_learned(symmetry: Symmetry) -> None:
    learned = learn(shown(symmetry, cared=True))
    (condition,) = posed(learned)
    assert turned_rad(condition.orientation, about_z(0.7), symmetry) < 0.05
    assert math.radians(10) <= condition.angle <= math.radians(25)
    assert (learned.tree.vocabulary, learned.doubts) == (2, ())
    assert from_xml(to_xml(learned.tree)) == learned.tree
    assert '<Condition ID="ObjectPosedAt">' in to_xml(learned.tree)


@pytest.mark.parametrize(
    ("symmetry", "cared", "begun_alike"),
    [("none", False, False), ("cube", True, False), ("vertical", True, False), ("none", True, True)],
)
def test_one_that_does_not_matter_or_that_nobody_turned_is_not(
    symmetry: Symmetry, cared: bool, begun_alike: bool
) -> None:
    learned = learn(shown(symmetry, cared, begun_alike=begun_alike))
    assert not posed(learned)
    assert "ObjectPosedAt" not in to_xml(learned.tree)


def test_a_cell_asks_for_the_orientation_up_to_symmetry() -> None:
    condition = ObjectPosedAt("B", "tray", (0.0, 0.0, 0.0), 0.05, about_z(0.5), 0.2)
    answers = {}
    for symmetry in ("none", "box"):
        state = CellState("base", "tool0", Answering(Scene({"B": ObjectShape((0.05, 0.04, 0.03), symmetry)})))  # type: ignore[arg-type]  # both are symmetries
        state.update_pose("tray", 1, Pose((0.5, 0.0, 0.0), about_z(1.0)))
        for stamp_ns, degrees in ((2, 0), (3, 180), (4, 60)):
            state.update_pose("B", stamp_ns, Pose((0.5, 0.0, 0.0), about_z(1.5 + math.radians(degrees))))
            answers[symmetry, degrees] = state.holds(condition)
    assert [key for key, holds in answers.items() if holds] == [("none", 0), ("box", 0), ("box", 180)]


def test_what_lies_the_wrong_way_round_is_turned_and_not_taken_for_done() -> None:
    demonstrations = shown("none", cared=True)
    learned = learn(demonstrations, rehearsed=True)
    (condition,) = posed(learned)
    stage = Stage(demonstrations, learned.parameters.rehearsal)
    start, root = stage.starts[0].spots, stage.root(learned.tree.flattened())
    right = stage.root(Tree(Definition("T", leaf(condition))).flattened())
    for wrong_rad in (math.pi, math.pi / 2, -1.0):
        tray = start["tray"]
        there = tray.compose(type(tray)(*stage.point("tray", condition.position), 0.0))
        world = stage.world({**start, "B": type(tray)(there.x, there.y, there.z, tray.yaw + 0.7 + wrong_rad)},
                            np.random.default_rng(1))  # fmt: skip
        assert not world.check(right)
        ticker, statuses = Ticker(root, world), []
        for _ in range(200):
            statuses.append(ticker.tick())
            world.step()
        assert statuses[-1] is Status.SUCCESS
        assert world.check(right)
        assert (
            turned_rad(world.spot("tray").relative(world.spot("B")).pose().quaternion_xyzw, about_z(0.7), "none") < 0.4
        )
