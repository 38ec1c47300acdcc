"""Trees written by hand from a scenario's script: what a programmer would write who knows every frame and number.

The experiments' yardstick, and the proof that the worlds and scenarios can be mastered. No repeated placements.
"""

from __future__ import annotations

from learner.model import Definition, Drop, GripperIs, InGripper, Node, Pick, Place, SetGripper, Tree
from learner.model.condition import DROP_RADIUS_M
from learner.model.pose import Quaternion
from learner.model.tree import fallback, leaf, sequence
from learner.simulation.script import ScriptedMove

from .scenarios import Scenario

DOWNWARDS: Quaternion = (1.0, 0.0, 0.0, 0.0)


def handwritten(scenario: Scenario) -> Tree:
    """The tree of the first script: every placement in order, each retried until it holds."""
    return Tree(Definition(scenario.name, sequence(*(_placement(step) for step in scenario.scripts[0]))))


def _placement(step: ScriptedMove) -> Node:
    release = _release(step)
    grasp = fallback(leaf(InGripper(step.object)), sequence(fallback(leaf(GripperIs("open")), leaf(SetGripper("open"))),
                     leaf(Pick(step.object, step.object, (0.0, 0.0, 0.0), DOWNWARDS))))  # fmt: skip
    return fallback(leaf(release.achieves), sequence(grasp, leaf(release)))


def _release(step: ScriptedMove) -> Place | Drop:
    if step.type == "place":
        return Place(step.object, step.frame, step.at, DOWNWARDS, step.at)
    return Drop(step.object, step.frame, step.at, DOWNWARDS, step.at, DROP_RADIUS_M)
