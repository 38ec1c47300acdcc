"""The paper's planner: trees grown backwards from the goal in a world whose leaves fail (section III-C)."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learner.execution.perception import condition_of
from learner.execution.ticking import Status, Ticker
from learner.model import (
    Action,
    Condition,
    GripperIs,
    InGripper,
    Node,
    ObjectAt,
    ObjectRoughlyAt,
    Pick,
    Place,
    SetGripper,
)
from learner.model.tree import leaf
from learner.paper.backchaining import Operator, PlannedTree, Planner
from learner.paper.pointworld import PointWorld

DOWN, HAND = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.1)
COSTS = {Pick: 20.0, Place: 20.0, SetGripper: 2.0}
GRIPPER: list[Action] = [SetGripper("open"), SetGripper("closed")]


def pick(name: str) -> Pick:
    return Pick(name, name, HAND, DOWN)


def place(name: str, x: float = 0.0) -> Place:
    return Place(name, "base", HAND, DOWN, (x, 0.0, 0.0))


def operator(action: Action, *guards: Condition, cost: float | None = None) -> Operator:
    before = (*guards, *sorted(action.preconditions, key=repr))
    return Operator(action, before, action.postconditions, cost or COSTS[type(action)])  # type: ignore[index]


def planned(goals: list[Condition], actions: list[Action]) -> PlannedTree:
    return Planner(goals, [operator(action) for action in actions]).plan()


def plan(goals: list[Condition], actions: list[Action]) -> Node:
    found = planned(goals, actions)
    assert found.reached
    return found.root


class Points:
    """The leaves of a tree in a world of points, in which an action needs its preconditions."""

    def __init__(self, operators: list[Operator]) -> None:
        frames = [{*vars(o.action).values()} & {"A", "B", "C", "base"} for o in operators]
        self.world = PointWorld(set[str]().union(*frames))
        self.operators = {leaf(operator.action): operator for operator in operators}
        self.done: list[Action] = []

    def check(self, node: Node) -> bool:
        return self.world.holds(condition_of(node))

    def tick_action(self, node: Node) -> Status:
        chosen = self.operators[node]
        if not all(self.world.holds(condition) for condition in chosen.preconditions):
            return Status.FAILURE
        self.done.append(chosen.action)
        self.world.do(chosen.action)
        return Status.SUCCESS

    def halt_action(self, node: Node) -> None:
        raise AssertionError("nothing runs in a world in which all happens at once")


def reached(root: Node, world: Points, goals: list[Condition]) -> bool:
    ticker = Ticker(root, world)
    succeeds = any(ticker.tick() is Status.SUCCESS for _ in range(100))
    return succeeds and all(world.world.holds(goal) for goal in goals)


def test_the_tree_for_holding_an_object_is_that_of_the_paper() -> None:
    root = plan([InGripper("A")], [pick("A"), *GRIPPER])
    held = root.children[0]
    assert root.kind == "ReactiveSequence"
    assert [child.kind for child in held.children] == ["InGripper", "ReactiveSequence"]
    opened, picked = held.children[1].children
    assert [child.kind for child in opened.children] == ["GripperIs", "SetGripper"]
    assert picked == leaf(pick("A"))


def test_of_two_actions_that_achieve_a_condition_the_cheaper_one_is_taken() -> None:
    dear, cheap = operator(place("A", 0.1)), operator(SetGripper("open"))
    root = Planner([GripperIs("open")], [dear, cheap]).plan().root
    assert [node.kind for node in root.walk() if node.kind in ("Place", "SetGripper")] == ["SetGripper"]
    root = Planner([GripperIs("open")], [operator(place("A", 0.1), cost=1.0), cheap, operator(pick("A"))]).plan().root
    assert next(node.kind for node in root.walk() if node.kind in ("Place", "SetGripper")) == "Place"


def test_of_actions_that_achieve_a_condition_at_equal_cost_all_are_taken_in_the_order_given() -> None:
    one, other = pick("A"), Pick("A", "base", HAND, DOWN)
    gripper = [operator(action) for action in GRIPPER]
    for first, second in ((one, other), (other, one)):
        root = Planner([InGripper("A")], [operator(first), operator(second), *gripper]).plan().root
        chains = root.children[0].children[1:]
        assert [chain.children[-1] for chain in chains] == [leaf(first), leaf(second)]


def test_the_order_of_operators_that_do_not_compete_does_not_matter() -> None:
    actions: list[Action] = [pick("A"), place("A"), pick("B"), place("B", 0.4), *GRIPPER]
    goals: list[Condition] = [place("A").achieves, place("B", 0.4).achieves]
    assert plan(goals, actions) == plan(goals, actions[::-1])


def in_two_contexts() -> tuple[list[Operator], list[Condition], list[Place]]:
    """A and B are put down, then B elsewhere, then A upon B; each pick knows its context by where things are."""
    places = [place("A", 0.1), place("B", 0.3), place("B", 0.5), Place("A", "B", HAND, DOWN, (0.0, 0.0, 0.05))]
    a_down, b_down, b_moved, a_upon = (p.achieves for p in places)
    again = [Pick(name, name, (0.0, 0.0, 0.01), DOWN) for name in "AB"]
    operators = [
        operator(pick("A")),
        operator(places[0]),
        operator(pick("B"), a_down),
        operator(places[1], a_down),
        operator(again[1], a_down, b_down),
        operator(places[2], a_down),
        operator(again[0], a_down, b_moved),
        operator(places[3], b_moved),
        *(operator(action) for action in GRIPPER),
    ]
    return operators, [b_moved, a_upon, GripperIs("open"), InGripper("none")], places


def test_what_happens_twice_in_two_contexts_is_done_twice() -> None:
    operators, goals, places = in_two_contexts()
    found = Planner(goals, operators).plan()
    assert found.reached
    world = Points(operators)
    assert reached(found.root, world, goals)
    assert [action for action in world.done if isinstance(action, Place)] == [places[0], places[2], places[3]]


def test_the_way_back_into_a_context_that_has_passed_is_not_taken() -> None:
    """When A shall be put upon B, A no longer lies where it did when it was first picked: that is not undone."""
    operators, goals, places = in_two_contexts()
    (upon,) = [
        child for child in Planner(goals, operators).plan().root.children if child.children[:1] == (leaf(goals[1]),)
    ]
    assert leaf(places[0]) not in upon.walk()
    assert leaf(places[3]) in upon.walk()


def test_what_failed_beside_something_that_works_is_not_expanded() -> None:
    blocked = operator(Pick("A", "base", HAND, DOWN), place("B", 0.4).achieves)
    others = [operator(action) for action in (pick("A"), place("A"), pick("B"), place("B", 0.4), place("C"), pick("C"))]
    goals: list[Condition] = [place("A").achieves, place("C").achieves]
    root = Planner(goals, [blocked, *others, *(operator(action) for action in GRIPPER)]).plan().root
    assert leaf(blocked.action) in root.walk()
    assert leaf(place("B", 0.4)) not in root.walk()


def test_an_action_is_not_prepared_by_itself() -> None:
    a, b = place("A"), place("B", 0.4)
    circle = [operator(pick("A")), operator(pick("B")), operator(a, b.achieves), operator(b, a.achieves)]
    found = Planner([a.achieves], [*circle, *(operator(action) for action in GRIPPER)]).plan()
    assert not found.reached
    assert found.root.depth < 10
    assert sum(node == leaf(a) for node in found.root.walk()) == 1


@settings(max_examples=40, deadline=None)
@given(st.permutations("ABC"), st.booleans())
def test_every_plan_reaches_its_goal_in_the_abstract_world(order: list[str], guarded: bool) -> None:
    places = {name: place(name, 0.2 * number) for number, name in enumerate(order)}
    operators = [operator(action) for action in (*map(pick, order), *GRIPPER)]
    for number, name in enumerate(order):
        earlier = [places[other].achieves for other in order[:number]] if guarded else []
        operators.append(operator(places[name], *earlier))
    goals: list[Condition] = [*(places[name].achieves for name in order), GripperIs("open"), InGripper("none")]
    root = Planner(goals, operators).plan().root
    world = Points(operators)
    assert reached(root, world, goals)
    assert [action for action in world.done if isinstance(action, Place)] == [places[name] for name in order]


def test_a_goal_that_was_undone_is_reached_again() -> None:
    operators = [operator(action) for action in (pick("A"), place("A"), *GRIPPER)]
    goals: list[Condition] = [place("A").achieves]
    root, world = Planner(goals, operators).plan().root, Points(operators)
    assert reached(root, world, goals)
    world.world.reset()
    assert reached(root, world, goals)
    assert world.done.count(place("A")) == 2


def test_a_goal_that_holds_already_needs_no_action() -> None:
    operators = [operator(action) for action in (pick("A"), place("A"), *GRIPPER)]
    goals: list[Condition] = [place("A").achieves]
    world = Points(operators)
    for action in (pick("A"), place("A")):
        world.world.do(action)
    assert reached(Planner(goals, operators).plan().root, world, goals)
    assert world.done == []


def test_what_an_action_undoes_to_its_left_comes_after_it() -> None:
    place_b = place("B", 0.4)
    held_first = Operator(place("A"), (InGripper("A"), place_b.achieves), place("A").postconditions, 20.0)
    operators = [held_first, *(operator(action) for action in (pick("A"), pick("B"), place_b, *GRIPPER))]
    goals: list[Condition] = [place("A").achieves]
    root, world = Planner(goals, operators).plan().root, Points(operators)
    assert reached(root, world, goals)
    chain = root.children[0].children[1]
    assert [child.children[0].kind for child in chain.children[:2]] == ["ObjectAt", "InGripper"]
    assert world.done[-2:] == [pick("A"), place("A")]


@pytest.mark.parametrize(
    "goals",
    [
        [place("A").achieves, place("A", 0.3).achieves],
        [InGripper("A"), InGripper("B")],
        [ObjectRoughlyAt("Z", "base", (0.0, 0.0, 0.0))],
        [ObjectAt("Z", "base", (0.0, 0.0, 0.0))],
    ],
    ids=["one object at two places", "two objects in one gripper", "out of reach", "out of reach exactly"],
)
def test_a_goal_that_no_plan_reaches_makes_a_tree_that_says_so(goals: list[Condition]) -> None:
    actions = [pick("A"), pick("B"), place("A"), place("A", 0.3), *GRIPPER]
    found = planned(goals, actions)
    assert not found.reached
    assert {leaf(goal) for goal in goals} <= set(found.root.walk())
