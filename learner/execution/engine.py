"""py_trees as the engine of a controller: the same leaves, the same ticks as learner.execution.ticking.

py_trees 2.6 has BehaviorTree.CPP's nodes under other names. What has to be bridged:

- ReactiveSequence is `Sequence(memory=False)`, ReactiveFallback is `Selector(memory=False)`; Sequence and Fallback are
  they with memory; ForceSuccess is FailureIsSuccess, ForceFailure SuccessIsFailure (both pass RUNNING on).
- py_trees invalidates children also when they have ended, as tidying before the next round. BehaviorTree.CPP halts only
  what is RUNNING; so a leaf tells the world of a halt only then.
- py_trees has no word for the root's end: a behaviour that is not RUNNING begins anew by itself, as
  BehaviorTree.CPP's does after `Tree` has reset it.

tests/integration/test_ticking_equivalence.py holds both against the real BehaviorTree.CPP.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status as PyTreesStatus
from py_trees.composites import Selector, Sequence
from py_trees.decorators import FailureIsSuccess, Inverter, SuccessIsFailure

from learner.errors import TreeError
from learner.execution.ticking import Leaves, Status
from learner.model.tree import ACTIONS, CONDITIONS, Node

TO_PY_TREES: Final = {
    Status.RUNNING: PyTreesStatus.RUNNING,
    Status.SUCCESS: PyTreesStatus.SUCCESS,
    Status.FAILURE: PyTreesStatus.FAILURE,
}
FROM_PY_TREES: Final = {theirs: ours for ours, theirs in TO_PY_TREES.items()}

COMPOSITES: Final[dict[str, Callable[[list[Behaviour]], Behaviour]]] = {
    "Sequence": lambda children: Sequence("Sequence", memory=True, children=children),
    "ReactiveSequence": lambda children: Sequence("ReactiveSequence", memory=False, children=children),
    "Fallback": lambda children: Selector("Fallback", memory=True, children=children),
    "ReactiveFallback": lambda children: Selector("ReactiveFallback", memory=False, children=children),
    "Inverter": lambda children: Inverter("Inverter", *children),
    "ForceSuccess": lambda children: FailureIsSuccess("ForceSuccess", *children),
    "ForceFailure": lambda children: SuccessIsFailure("ForceFailure", *children),
}


class Engine:
    """A flattened tree bound to its leaves, ticked by py_trees. Raises TreeError as the Ticker does."""

    def __init__(self, root: Node, world: Leaves) -> None:
        self.root = _behaviour(root, world)

    def tick(self) -> Status:
        """Tick once; the status of the root."""
        self.root.tick_once()
        return FROM_PY_TREES[self.root.status]

    def halt(self) -> None:
        """Halt the leaf that runs, if one does; the next tick begins anew."""
        self.root.stop(PyTreesStatus.INVALID)


class ConditionLeaf(Behaviour):
    """A condition: SUCCESS if the world says that it holds, else FAILURE."""

    def __init__(self, node: Node, world: Leaves) -> None:
        super().__init__(node.kind)
        self.node, self.world = node, world

    def update(self) -> PyTreesStatus:
        return PyTreesStatus.SUCCESS if self.world.check(self.node) else PyTreesStatus.FAILURE


class ActionLeaf(Behaviour):
    """An action: it is halted only if it was RUNNING."""

    def __init__(self, node: Node, world: Leaves) -> None:
        super().__init__(node.kind)
        self.node, self.world = node, world

    def update(self) -> PyTreesStatus:
        return TO_PY_TREES[self.world.tick_action(self.node)]

    def terminate(self, new_status: PyTreesStatus) -> None:
        if self.status is PyTreesStatus.RUNNING and new_status is PyTreesStatus.INVALID:
            self.world.halt_action(self.node)


def _behaviour(node: Node, world: Leaves) -> Behaviour:
    if node.kind in CONDITIONS:
        return ConditionLeaf(node, world)
    if node.kind in ACTIONS:
        return ActionLeaf(node, world)
    if node.kind not in COMPOSITES:
        raise TreeError(f"{node.kind} {node.id or ''} cannot be ticked: flatten the tree first")
    return COMPOSITES[node.kind]([_behaviour(child, world) for child in node.children])
