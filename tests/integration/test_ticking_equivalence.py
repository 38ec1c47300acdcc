"""One meaning of a tick: our interpreter, py_trees and the real BehaviorTree.CPP, call for call.

Random trees with scripted leaves: what a leaf returns depends on the leaf and the number of the tick alone, so that
the three runs see the same world as long as they do the same. Compared are the status of every tick, and every call of
a leaf and every halt, in order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from support_btcpp import CppTicker, leaves

from learner.execution.engine import Engine
from learner.execution.entries import Found
from learner.execution.ticking import Leaves, Status, Ticker
from learner.model.tree import Node
from learner.model.vocabulary import DECORATORS, FALLBACKS, SEQUENCES

R, S, F = Status.RUNNING, Status.SUCCESS, Status.FAILURE
TICKS = 10
Script = tuple[Status, ...]
Make = Callable[[Node, Leaves], Ticker | Engine | CppTicker]


@dataclass
class Scripted:
    """The leaves of `root`: leaf number i returns `scripts[i][tick]`; a condition holds unless that is FAILURE."""

    root: Node
    scripts: Sequence[Script]
    now: int = 0
    log: list[tuple[int, str, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.numbers = {id(node): number for number, node in enumerate(leaves(self.root))}

    def _scripted(self, call: str, node: Node) -> Status:
        number = self.numbers[id(node)]
        self.log.append((self.now, call, number))
        return self.scripts[number][self.now]

    def check(self, node: Node) -> bool:
        return self._scripted("check", node) is not F

    def find(self, node: Node) -> Found | None:
        raise AssertionError(f"there is no {node.kind} here")

    def tick_action(self, node: Node) -> Status:
        return self._scripted("tick", node)

    def halt_action(self, node: Node) -> None:
        self.log.append((self.now, "halt", self.numbers[id(node)]))


def action(name: str = "A") -> Node:
    ports = {"object": name, "frame": "base", "position": (0.0, 0.0, 0.0), "orientation": (0.0, 0.0, 0.0, 1.0)}
    return Node("Pick", tuple(sorted(ports.items())))


def condition(name: str = "A") -> Node:
    return Node("InGripper", (("object", name),))


def control(kind: str, *children: Node) -> Node:
    return Node(kind, (), children)


def controls(children: st.SearchStrategy[Node]) -> st.SearchStrategy[Node]:
    composite = st.builds(
        lambda kind, below: control(kind, *below),
        st.sampled_from([*SEQUENCES, *FALLBACKS]),
        st.lists(children, min_size=1, max_size=4),
    )
    decorator = st.builds(control, st.sampled_from(DECORATORS), children)
    return st.one_of(composite, composite, decorator)


# Builders, not values: equal leaves at two places have to be two objects, as in a flattened tree.
TREES = st.recursive(st.builds(condition) | st.builds(action) | st.builds(action), controls, max_leaves=12)
STATUSES = st.sampled_from([R, R, S, S, F, F])


@st.composite
def scenarios(draw: st.DrawFn) -> tuple[Node, list[Script], set[int]]:
    root = draw(TREES)
    script = st.lists(STATUSES, min_size=TICKS, max_size=TICKS).map(tuple)
    scripts = [draw(script) for _ in leaves(root)]
    return root, scripts, draw(st.sets(st.integers(0, TICKS - 1), max_size=2))


def observed(make: Make, root: Node, scripts: Sequence[Script], halted_after: set[int]) -> object:
    """Each tick's status, every call of a leaf and every halt; the tree is halted from outside after some ticks."""
    world = Scripted(root, scripts)
    tree, statuses = make(root, world), list[Status]()
    for world.now in range(TICKS):
        statuses.append(tree.tick())
        if world.now in halted_after:
            tree.halt()
    tree.halt()
    return statuses, world.log


GUARDED = control("ReactiveFallback", control("ReactiveSequence", condition(), action()), action())
REMEMBERED = control("ReactiveSequence", condition(), control("Sequence", action(), action(), action()))


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(scenarios())
@example((GUARDED, [(F, S) * 5, (R,) * TICKS, (R,) * TICKS], {7}))
@example((REMEMBERED, [(S, S, F, S, S) * 2, (R, S) * 5, (R, S) * 5, (R,) * TICKS], set()))
def test_the_interpreter_py_trees_and_behaviortree_cpp_make_the_same_calls(
    scenario: tuple[Node, list[Script], set[int]],
) -> None:
    expected = observed(CppTicker, *scenario)
    assert observed(Ticker, *scenario) == expected
    assert observed(Engine, *scenario) == expected


def test_the_comparison_would_see_a_missed_halt() -> None:
    class Deaf(Scripted):
        def halt_action(self, node: Node) -> None:
            """A world that is not told."""

    scripts = [(F, S) * 5, (R,) * TICKS, (R,) * TICKS]
    heard, deaf = Scripted(GUARDED, scripts), Deaf(GUARDED, scripts)
    for world in (heard, deaf):
        tree = Ticker(GUARDED, world)
        for world.now in range(TICKS):
            tree.tick()
    assert heard.log != deaf.log
    assert [call for call in heard.log if call[1] != "halt"] == deaf.log


@pytest.mark.parametrize("make", [Ticker, Engine, CppTicker])
def test_a_tree_nested_as_deep_as_the_contract_admits_is_ticked(make: Make) -> None:
    root = action()
    for _ in range(248):
        root = control("Inverter", root)
    world = Scripted(root, [(R, S) * 5])
    tree = make(root, world)
    assert tree.tick() is R
    world.now = 1
    assert tree.tick() is S
