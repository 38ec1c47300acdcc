"""Recordings of another writer, read, observed and learned from; skipped where the shared samples are absent."""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
import pytest
from support_demonstrations import scattered
from support_pose_world import PoseWorld, done

from learner.learning import METHODS, learn
from learner.model import DemonstratedAction, Demonstration
from learner.model.pose import rotate
from learner.observation import observe
from recorder.recording import read_recording

SAMPLES = Path(__file__).parents[2].parent / "shared" / "data" / "contract_samples"
pytestmark = pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"there are no samples in {SAMPLES}")

KINDS = {"object_in_box": 4, "tower_and_box": 4, "tower_and_box_noisy": 6}
ORDERS = {"object_in_box": "A", "tower_and_box": "DFA", "tower_and_box_noisy": "DFA"}


@functools.cache
def demonstrations(kind: str) -> list[Demonstration]:
    files = (SAMPLES / f"{kind}-{number}.mcap" for number in range(1, KINDS[kind] + 1))
    return [observe(read_recording([file])) for file in files]


def placed(kind: str, method: str = "treewright") -> list[tuple[str, str, str]]:
    root = learn(demonstrations(kind), method=method).tree.flattened(recovery=False)
    found = {(n.kind, str(n.port("object")), str(n.port("frame"))) for n in root.walk() if n.kind in ("Place", "Drop")}
    return sorted(found)


@pytest.mark.parametrize("kind", KINDS)
def test_every_sample_is_a_demonstration_that_keeps_the_contract(kind: str) -> None:
    for found in demonstrations(kind):
        assert [action.type for action in found.actions[::2]] == ["pick"] * (len(found.actions) // 2)
        moved = [action.object for action in found.actions if action.type != "pick"]
        assert "".join(moved).endswith(ORDERS[kind]) or kind == "tower_and_box_noisy"
        assert set(ORDERS[kind]) <= set(moved)


@pytest.mark.parametrize("kind", KINDS)
def test_cubes_rest_where_the_task_puts_them_whatever_the_noise(kind: str) -> None:
    """Stacked origins are 5 cm apart; what was dropped lies inside the box."""
    within_m = 0.02 if kind == "tower_and_box_noisy" else 0.012
    for found in demonstrations(kind):
        for action in found.actions:
            if action.type == "place" and action.object in "DF" and action is _last(found, action.object):
                below = action.frames[action.frames.index("E" if action.object == "D" else "D")]
                assert math.dist((action.rest or {})[below].position, (0.0, 0.0, 0.0)) == pytest.approx(
                    0.05, abs=within_m
                )
            if action.object == "A" and action is _last(found, "A"):
                box = next(name for name in found.objects if name.startswith("box"))
                assert math.hypot(*(action.rest or {})[box].position[:2]) < 0.15


def _last(demonstration: Demonstration, name: str) -> DemonstratedAction:
    return [a for a in demonstration.actions if a.object == name and a.type != "pick"][-1]


@pytest.mark.parametrize("kind", KINDS)
def test_the_frames_of_the_samples_are_found(kind: str) -> None:
    wanted = [("Drop", "A", "box")]
    if kind != "object_in_box":
        wanted += [("Place", "D", "E"), ("Place", "F", "D")]
    assert placed(kind) == wanted


@pytest.mark.parametrize("kind", KINDS)
def test_our_trees_of_the_samples_are_small_and_certain(kind: str) -> None:
    found = learn(demonstrations(kind))
    assert found.tree.nodes == 11 * len(ORDERS[kind]) + 1
    assert all(action["certainty"] >= 0.95 for action in found.report["actions"])
    assert found.report["questions"] == []


def test_cubes_are_grasped_at_their_faces_where_only_the_other_cubes_tell_how() -> None:
    """Two users' picks of D lie at 36, 47, 17 and 2 degrees to its faces: its marker came late."""
    shown = [found for found in demonstrations("tower_and_box_noisy") if found.user in ("user01", "user02")]
    picks = [node for node in learn(shown).tree.flattened(recovery=False).walk() if node.kind == "Pick"]
    assert [pick.port("object") for pick in picks] == list(ORDERS["tower_and_box_noisy"])
    for pick in picks:
        orientation = np.array(pick.port("orientation"))
        x, y, _ = rotate(orientation, np.array([1.0, 0.0, 0.0]))
        assert abs(math.sin(2 * math.atan2(y, x))) < math.sin(math.radians(2 * 5)), pick.port("object")


@pytest.mark.parametrize("method", METHODS)
def test_the_tree_of_every_method_puts_the_object_in_the_box(method: str) -> None:
    tree = learn(demonstrations("object_in_box"), method=method).tree
    assert tree.nodes <= 16
    for seed in range(3):
        world = PoseWorld(scattered(["A", "box"], np.random.default_rng(seed)))
        assert done(tree, world), world.faults
        assert math.hypot(*world.position("A", "box")[:2]) < 0.10


def test_our_tree_builds_the_tower_from_new_starts() -> None:
    tree = learn(demonstrations("tower_and_box")).tree
    for seed in range(3):
        rng = np.random.default_rng(seed)
        world = PoseWorld(scattered([*"ADEF", "box"], rng, 0.2))
        assert done(tree, world), world.faults
        for upper, lower in (("D", "E"), ("F", "D")):
            x, y, z = np.subtract(world.position(upper), world.position(lower))
            assert math.hypot(x, y) < 0.02
            assert z == pytest.approx(0.05, abs=0.02)


def test_learning_from_the_samples_gives_the_same_bytes_in_any_order() -> None:
    found = demonstrations("tower_and_box_noisy")
    assert learn(found[::-1]).tree.digest == learn(found).tree.digest
