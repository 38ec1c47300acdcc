"""Learned trees, exported as XML, in the real BehaviorTree.CPP: ticked in worlds of the tests until the goal holds."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS
from support_btcpp import CppTicker
from support_demonstrations import scattered
from support_pose_world import PoseWorld

from learner.execution.ticking import Status
from learner.learning import METHODS, learn
from learner.model import Demonstration, Pose, Tree
from learner.model.names import NODES
from learner.observation import observe
from learner.parameters import Parameters
from learner.planning.synthesis import main_id
from learner.simulation.kinematic_world import KinematicWorld
from recorder.imports.yaml_import import import_folder
from recorder.recording import read_recording
from storage.btcpp import from_xml, to_xml, validate
from storage.errors import WrittenTreeError

SHARED = Path(__file__).parents[2].parent / "shared" / "data"
SAMPLES = {"object_in_box": 4, "tower_and_box": 4, "tower_and_box_noisy": 6}


def exported(tree: Tree) -> str:
    """The XML of a tree, validated, from which the same tree is read."""
    xml = to_xml(tree)
    validate(xml)
    assert from_xml(xml) == tree
    return xml


def ticked_to_success(tree: Tree, world: PoseWorld) -> bool:
    ticker = CppTicker(tree.flattened(), world, exported(tree))
    return any(ticker.tick() is Status.SUCCESS for _ in range(400))


@pytest.mark.parametrize("name", ["object_in_box", "tower_and_box", "hanoi", "two_goals"])
def test_a_learned_tree_reaches_the_goal_in_the_real_engine_despite_noise(name: str) -> None:
    scenario = SCENARIOS[name]
    tree = METHODS["treewright"](demonstrated(scenario, scenario.least, 5), Parameters()).tree
    world = KinematicWorld(
        scenario.objects, scenario.draw_start(np.random.default_rng(11)), np.random.default_rng(12)
    )  # fmt: skip
    ticker = CppTicker(tree.flattened(), world, exported(tree))
    for _ in range(600):
        if ticker.tick() is Status.SUCCESS and scenario.reached(world.table.spots, world.held):
            return
        world.step()
    pytest.fail(f"{name} was not reached; {world.attempts[-3:]}")


def test_the_tree_of_a_real_yumi_puts_the_cube_where_the_marker_is(tmp_path: Path) -> None:
    if not (SHARED / "yumi_cube_in_box").is_dir():
        pytest.skip(f"there are no recordings in {SHARED}")
    files = import_folder(SHARED / "yumi_cube_in_box", tmp_path, "cube_in_box", "u1").imported
    shown = [observe(read_recording([file])) for file in files]
    tree = learn(shown).tree
    assert tree.nodes <= 16
    upright = shown[0].actions[1].objects["marker_61"].quaternion_xyzw
    for x, y in ((0.5, 0.1), (0.4, -0.2), (0.6, 0.25)):
        start = {"A": shown[0].initial["A"], "marker_61": Pose((x, y, 0.05), upright)}
        world = PoseWorld(start, base="abb_yumi_base_link")
        assert ticked_to_success(tree, world), world.faults
        at = np.subtract(world.position("A", "abb_yumi_base_link"), world.position("marker_61", "abb_yumi_base_link"))
        assert math.hypot(*at[:2]) < 0.1


@pytest.mark.parametrize("kind", SAMPLES)
def test_the_trees_of_another_writers_recordings_reach_the_goal(kind: str) -> None:
    if not (SHARED / "contract_samples").is_dir():
        pytest.skip(f"there are no recordings in {SHARED}")
    files = [SHARED / "contract_samples" / f"{kind}-{number + 1}.mcap" for number in range(SAMPLES[kind])]
    shown: list[Demonstration] = [observe(read_recording([file])) for file in files]
    tree = learn(shown).tree
    for seed in range(2):
        world = PoseWorld(scattered(list(shown[0].objects), np.random.default_rng(seed)))
        assert ticked_to_success(tree, world), world.faults
        assert math.hypot(*world.position("A", "box")[:2]) < 0.1


@pytest.mark.parametrize("method", METHODS)
def test_a_task_may_be_called_as_any_node_is(method: str) -> None:
    """Names that no tree can bear are written so that the tree loads, and `verify` refuses those that are not."""
    shown = demonstrated(SCENARIOS["object_in_box"], 3, 5)
    learned = METHODS[method](shown, Parameters()).tree
    taken = [definition.id for definition in learned.subtrees]
    for name in (*sorted(NODES), "Hold", "Recover_Put_down", "7", "2.x-y", *taken):
        tree = replace(learned, main=replace(learned.main, id=main_id([replace(shown[0], task=name)])))
        xml = exported(tree)
        assert CppTicker(tree.flattened(), PoseWorld(shown[0].initial), xml).tick() is not Status.SUCCESS
        if name in NODES:
            with pytest.raises(WrittenTreeError, match=f"the ID {name}, which is the name of a node"):
                validate(xml.replace(f'"T{name}"', f'"{name}"'))
