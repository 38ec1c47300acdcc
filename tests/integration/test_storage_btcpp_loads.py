"""Exported trees in the real BehaviorTree.CPP."""

from __future__ import annotations

from hypothesis import HealthCheck, given, settings
from support_btcpp import CppTicker
from support_trees import trees

from learner.execution.ticking import Status, Ticker
from learner.model.tree import Node, Tree
from storage.btcpp import to_xml


class Scripted:
    """Leaves that answer by turns, and remember who was asked and halted."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, str]] = []

    def check(self, node: Node) -> bool:
        return self._next("check", node) % 2 == 0

    def tick_action(self, node: Node) -> Status:
        return (Status.RUNNING, Status.SUCCESS, Status.FAILURE)[self._next("tick", node) % 3]

    def halt_action(self, node: Node) -> None:
        self._next("halt", node)

    def _next(self, what: str, node: Node) -> int:
        self.calls.append((what, node.kind))
        return len(self.calls)


@given(trees())
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_every_exported_tree_loads_and_ticks_as_its_flattened_form_does(tree: Tree) -> None:
    ours, theirs = Scripted(), Scripted()
    ticker = Ticker(tree.flattened(), ours)
    cpp = CppTicker(tree.flattened(), theirs, to_xml(tree))
    for _ in range(4):
        assert ticker.tick() == cpp.tick()
        assert ours.calls == theirs.calls
