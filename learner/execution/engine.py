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

from collections.abc import Callable, Iterator
from typing import Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status as PyTreesStatus
from py_trees.composites import Selector, Sequence
from py_trees.decorators import FailureIsSuccess, Inverter, SuccessIsFailure

from learner.errors import TreeError
from learner.execution.entries import Entries
from learner.execution.ticking import Leaves, Status
from learner.model.tree import Node
from learner.model.vocabulary import ACTIONS, CONDITIONS, QUERIES

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
        self.root = _behaviour(root, world, Entries())
        self._behaviours = list(_walk(self.root))
        self._ticked: frozenset[int] = frozenset()

    def tick(self) -> Status:
        """Tick once; the status of the root."""
        self._ticked = frozenset(id(behaviour) for behaviour in self.root.tick())
        return FROM_PY_TREES[self.root.status]

    def halt(self) -> None:
        """Halt the leaf that runs, if one does; the next tick begins anew."""
        self.root.stop(PyTreesStatus.INVALID)

    def statuses(self) -> list[Status | None]:
        """What each node came to at the last tick, depth first as `Node.walk`; None where it was not ticked."""
        return [FROM_PY_TREES.get(each.status) if id(each) in self._ticked else None for each in self._behaviours]


class ConditionLeaf(Behaviour):
    """A condition: SUCCESS if the world says that it holds, else FAILURE."""

    def __init__(self, node: Node, world: Leaves, entries: Entries) -> None:
        super().__init__(node.kind)
        self.node, self.world, self.bound = node, world, entries.bound(node)

    def update(self) -> PyTreesStatus:
        filled = self.bound()
        return PyTreesStatus.SUCCESS if filled is not None and self.world.check(filled) else PyTreesStatus.FAILURE


class QueryLeaf(Behaviour):
    """A query: SUCCESS if the world finds something, which is written to its entries, else FAILURE."""

    def __init__(self, node: Node, world: Leaves, entries: Entries) -> None:
        super().__init__(node.kind)
        self.node, self.world, self.entries, self.bound = node, world, entries, entries.bound(node)

    def update(self) -> PyTreesStatus:
        filled = self.bound()
        found = None if filled is None else self.world.find(filled)
        if found is None:
            return PyTreesStatus.FAILURE
        self.entries.write(self.node, found)
        return PyTreesStatus.SUCCESS


class ActionLeaf(Behaviour):
    """An action: it is halted only if it was RUNNING, and keeps its ports from its start until its end."""

    def __init__(self, node: Node, world: Leaves, entries: Entries) -> None:
        super().__init__(node.kind)
        self.node, self.world, self.bound = node, world, entries.bound(node)
        self.running: Node | None = None

    def update(self) -> PyTreesStatus:
        filled, self.running = self.running or self.bound(), None
        if filled is None:
            return PyTreesStatus.FAILURE
        status = self.world.tick_action(filled)
        self.running = filled if status is Status.RUNNING else None
        return TO_PY_TREES[status]

    def terminate(self, new_status: PyTreesStatus) -> None:
        if self.running is not None and new_status is PyTreesStatus.INVALID:
            halted, self.running = self.running, None
            self.world.halt_action(halted)


def _walk(behaviour: Behaviour) -> Iterator[Behaviour]:
    yield behaviour
    for child in behaviour.children:
        yield from _walk(child)


def _behaviour(node: Node, world: Leaves, entries: Entries) -> Behaviour:
    if node.kind in QUERIES:
        return QueryLeaf(node, world, entries)
    if node.kind in CONDITIONS:
        return ConditionLeaf(node, world, entries)
    if node.kind in ACTIONS:
        return ActionLeaf(node, world, entries)
    if node.kind not in COMPOSITES:
        raise TreeError(f"{node.kind} {node.id or ''} cannot be ticked: flatten the tree first")
    return COMPOSITES[node.kind]([_behaviour(child, world, entries) for child in node.children])
