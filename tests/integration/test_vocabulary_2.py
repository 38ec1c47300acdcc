"""Trees of vocabulary 2 in the kinematic world, by three engines: hand-made ones, as far as they are there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support_btcpp import CppTicker

from learner.execution.engine import Engine
from learner.execution.ticking import Leaves, Status, Ticker
from learner.model import ObjectShape, Pose
from learner.model.tree import Node, Tree
from learner.model.upright import Spot
from learner.relations.grasping import Grasp
from learner.relations.knowledge import Knowledge
from learner.simulation.gravity import Body
from learner.simulation.kinematic_world import KinematicWorld
from storage.btcpp import from_xml, to_xml

SHARED = Path(__file__).parents[3] / "shared" / "data" / "vocabulary2"
CUBE = Body(ObjectShape((0.05, 0.05, 0.05), "cube"))
Make = Callable[[Node, Leaves], Ticker | Engine | CppTicker]


def towers() -> Tree:
    file = SHARED / "towers.xml"
    if not file.exists():
        pytest.skip(f"{file} is not there")
    return from_xml(file.read_text())


def world_of(tree: Tree, rng: np.random.Generator) -> KinematicWorld:
    """A pile of A upon B upon C upon D, somewhere, and a thing apart."""
    x, y, yaw = rng.uniform((0.35, -0.3, -3.0), (0.7, 0.3, 3.0)).tolist()
    spots = {name: Spot(x, y, 0.025 + 0.05 * level, yaw) for level, name in enumerate("DCBA")}
    grasps = [
        Grasp(Pose((0.0, 0.0, 0.0), q), size_m=CUBE.shape.size_m) for q in ((1.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0))
    ]
    knowledge = Knowledge.of(tree.flattened(), grasps)
    return KinematicWorld(dict.fromkeys("ABCD", CUBE), spots, rng, knowledge=knowledge)


@pytest.mark.parametrize("engine", ["ours", "py_trees", "C++"])
def test_a_hand_made_tree_builds_its_towers_from_a_pile_in_every_engine(engine: str) -> None:
    tree = towers()
    make: dict[str, Make] = {
        "ours": Ticker, "py_trees": Engine, "C++": lambda root, world: CppTicker(root, world, to_xml(tree)),
    }  # fmt: skip
    for seed in range(3):
        world = world_of(tree, np.random.default_rng(seed))
        ticker = make[engine](tree.flattened(), world)
        said = 0
        for _ in range(600):
            said = said + 1 if ticker.tick() is Status.SUCCESS else 0
            world.step()
            if said > 5:
                break
        assert said > 5
        assert {("A", "B"), ("C", "D")} <= {(upper, lower) for lower in "BD" for upper in world.table.on(lower)}
        assert world.faults.contacts == 0
