"""Exported trees in the real BehaviorTree.CPP: ports of SubTrees, and entries that queries write, as here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice, repeat
from typing import Final

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support_btcpp import CppTicker
from support_trees import trees

from learner.execution.engine import Engine
from learner.execution.entries import Found
from learner.execution.ticking import Status, Ticker
from learner.model.tree import Node, Tree, Value
from learner.model.vocabulary import outputs_of
from storage.btcpp import to_xml

TICKS: Final = 6
NAMES: Final = ("A", "box", "cube-1.b")


@dataclass
class Scripted:
    """Leaves that answer as a script says, call by call, and remember who was called with which ports."""

    script: Sequence[Status]
    calls: list[tuple[str, str, tuple[tuple[str, Value], ...]]] = field(default_factory=list)

    def check(self, node: Node) -> bool:
        return self._next("check", node) is not Status.FAILURE

    def find(self, node: Node) -> Found | None:
        if self._next("find", node) is Status.FAILURE:
            return None
        return {port: self._written(port) for port in outputs_of(node.kind)}

    def _written(self, port: str) -> Value:
        number = len(self.calls)
        numbers = {"position": 3, "orientation": 4}.get(port)
        return NAMES[number % 3] if numbers is None else tuple(islice(repeat(number / 3), numbers))

    def tick_action(self, node: Node) -> Status:
        return self._next("tick", node)

    def halt_action(self, node: Node) -> None:
        self._next("halt", node)

    def _next(self, what: str, node: Node) -> Status:
        read = tuple(port for port in node.ports if port[0] not in outputs_of(node.kind))
        self.calls.append((what, node.kind, read))
        return self.script[len(self.calls) % len(self.script)]


@given(trees(), st.lists(st.sampled_from(Status), min_size=5, max_size=30), st.integers(0, TICKS))
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_every_exported_tree_loads_and_ticks_as_its_flattened_form_does(
    tree: Tree, script: list[Status], halted_after: int
) -> None:
    root = tree.flattened()
    worlds = [Scripted(script) for _ in range(3)]
    tickers = [Ticker(root, worlds[0]), Engine(root, worlds[1]), CppTicker(root, worlds[2], to_xml(tree))]
    for now in range(TICKS):
        ours, engine, cpp = (ticker.tick() for ticker in tickers)
        assert ours == engine == cpp
        if now == halted_after:
            for ticker in tickers:
                ticker.halt()
        assert worlds[0].calls == worlds[1].calls == worlds[2].calls


def test_the_comparison_sees_what_a_query_has_written() -> None:
    from learner.model.tree import Definition, asked, sequence

    root = sequence(asked("FindHeld", object="{x}"), asked("FindUpon", object="{x}", found="{y}"))
    tree = Tree(Definition("Main", root))
    world = Scripted([Status.SUCCESS])
    assert CppTicker(tree.flattened(), world, to_xml(tree)).tick() is Status.SUCCESS
    assert [read for _, _, read in world.calls] == [(), (("object", NAMES[1]),)]
    with pytest.raises(AssertionError):
        assert world.calls[0] == world.calls[1]
