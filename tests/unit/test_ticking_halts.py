"""The ticking rules of BehaviorTree.CPP that learned trees rely on, one by one."""

from __future__ import annotations

import pytest

from learner.errors import TreeError
from learner.execution.ticking import Status, Ticker
from learner.model.condition import InGripper
from learner.model.tree import Node, fallback, leaf, sequence, subtree

R, S, F = Status.RUNNING, Status.SUCCESS, Status.FAILURE


class Scripted:
    """Leaves that return what their script says, and write down every call."""

    def __init__(self, **scripts: list[Status | bool]) -> None:
        self.scripts, self.log = scripts, list[str]()

    def check(self, node: Node) -> bool:
        self.log.append(str(node.port("object")))
        return bool(self.scripts[str(node.port("object"))].pop(0))

    def tick_action(self, node: Node) -> Status:
        self.log.append(f"tick {node.port('object')}")
        status = self.scripts[str(node.port("object"))].pop(0)
        assert isinstance(status, Status)
        return status

    def halt_action(self, node: Node) -> None:
        self.log.append(f"halt {node.port('object')}")


def action(name: str) -> Node:
    ports = {"object": name, "frame": "base", "position": (0.0, 0.0, 0.0), "orientation": (0.0, 0.0, 0.0, 1.0)}
    return Node("Pick", tuple(sorted(ports.items())))


def condition(name: str) -> Node:
    return leaf(InGripper(name))


def test_a_reactive_node_halts_the_running_child_after_the_new_one_was_ticked() -> None:
    world = Scripted(guard=[False, True], other=[R], work=[R])
    tree = Ticker(fallback(sequence(condition("guard"), action("work")), action("other")), world)
    assert [tree.tick(), tree.tick()] == [R, R]
    assert world.log == ["guard", "tick other", "guard", "tick work", "halt other"]


def test_a_reactive_sequence_that_fails_halts_the_child_that_ran() -> None:
    world = Scripted(guard=[True, False], work=[R])
    tree = Ticker(sequence(condition("guard"), action("work")), world)
    assert [tree.tick(), tree.tick()] == [R, F]
    assert world.log == ["guard", "tick work", "guard", "halt work"]


def test_a_child_that_ended_by_itself_is_not_halted() -> None:
    world = Scripted(first=[R, S], second=[F])
    tree = Ticker(sequence(action("first"), action("second")), world)
    assert [tree.tick(), tree.tick()] == [R, F]
    assert world.log == ["tick first", "tick first", "tick second"]


@pytest.mark.parametrize(("combine", "passes", "ends"), [(sequence, S, F), (fallback, F, S)])
def test_memory_skips_what_has_passed_until_the_node_ends(combine, passes, ends) -> None:  # type: ignore[no-untyped-def]
    world = Scripted(first=[passes, passes], second=[R, ends, R])
    tree = Ticker(combine(action("first"), action("second"), reactive=False), world)
    assert [tree.tick(), tree.tick(), tree.tick()] == [R, ends, R]
    assert world.log == ["tick first", "tick second", "tick second", "tick first", "tick second"]


def test_a_halted_memory_begins_anew() -> None:
    world = Scripted(first=[S, S], second=[R, R])
    tree = Ticker(sequence(action("first"), action("second"), reactive=False), world)
    tree.tick()
    tree.halt()
    tree.tick()
    assert world.log == ["tick first", "tick second", "halt second", "tick first", "tick second"]


def test_halting_reaches_through_decorators_and_twice_is_once() -> None:
    world = Scripted(work=[R])
    tree = Ticker(Node("Inverter", (), (Node("ForceFailure", (), (action("work"),)),)), world)
    assert tree.tick() is R
    tree.halt()
    tree.halt()
    assert world.log == ["tick work", "halt work"]


@pytest.mark.parametrize(
    ("kind", "returned"),
    [("Inverter", [F, S, R]), ("ForceSuccess", [S, S, R]), ("ForceFailure", [F, F, R])],
)
def test_a_decorator_maps_what_its_child_returns(kind: str, returned: list[Status]) -> None:
    tree = Ticker(Node(kind, (), (action("work"),)), Scripted(work=[S, F, R]))
    assert [tree.tick() for _ in range(3)] == returned


def test_equal_leaves_at_two_places_are_two_leaves() -> None:
    world = Scripted(guard=[False, True], work=[R, R])
    tree = Ticker(fallback(sequence(condition("guard"), action("work")), action("work")), world)
    tree.tick()
    tree.tick()
    assert world.log == ["guard", "tick work", "guard", "tick work", "halt work"]


def test_an_unflattened_tree_is_refused_by_name() -> None:
    with pytest.raises(TreeError, match="Somewhere"):
        Ticker(sequence(subtree("Somewhere")), Scripted())
