"""The paper's planner: trees grown backwards from the goal in a world whose leaves fail (section III-C)."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learner.backchaining import INITIAL, Operator, Planner, effects
from learner.errors import NothingLearnedError
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
    compatible,
)
from learner.model.tree import leaf
from learner.ticking import Status, Ticker

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


def plan(goals: list[Condition], actions: list[Action]) -> Node:
    return Planner(goals, [operator(action) for action in actions]).plan()


class Abstract:
    """The world of conditions: an action brings about what its post-conditions say."""

    def __init__(self, operators: list[Operator], state: frozenset[Condition] = INITIAL) -> None:
        self.state = state
        self.operators = {leaf(operator.action): operator for operator in operators}
        self.done: list[Action] = []

    def check(self, node: Node) -> bool:
        return node in {leaf(condition) for condition in self.state}

    def tick_action(self, node: Node) -> Status:
        chosen = self.operators[node]
        if not set(chosen.preconditions) <= self.state:
            return Status.FAILURE
        self.done.append(chosen.action)
        self.state = effects(chosen, self.state)
        return Status.SUCCESS

    def halt_action(self, node: Node) -> None:
        raise AssertionError("nothing runs in a world in which all happens at once")


def reached(root: Node, world: Abstract, goals: list[Condition]) -> bool:
    ticker = Ticker(root, world)
    return any(ticker.tick() is Status.SUCCESS for _ in range(100)) and set(goals) <= world.state


STATES = st.sampled_from([pick("A"), pick("B"), place("A"), place("A", 0.2), place("B", 0.4), *GRIPPER])


@given(st.lists(STATES, max_size=6))
def test_what_holds_in_the_abstract_world_can_always_hold_together(actions: list[Action]) -> None:
    state = INITIAL
    for action in actions:
        state = effects(operator(action), state)
        assert action.postconditions <= state
        assert all(compatible(a, b) for a in state for b in state)


@given(STATES)
def test_doing_a_thing_twice_changes_nothing_more(action: Action) -> None:
    once = effects(operator(action), INITIAL)
    assert effects(operator(action), once) == once


def test_what_is_picked_up_is_no_longer_where_it_was_and_the_rest_stays() -> None:
    state = INITIAL | {place("A").achieves, place("B", 0.4).achieves}
    assert place("A").achieves not in effects(operator(pick("A")), state)
    assert place("B", 0.4).achieves in effects(operator(pick("A")), state)


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
    root = Planner([GripperIs("open")], [dear, cheap]).plan()
    assert [node.kind for node in root.walk() if node.kind in ("Place", "SetGripper")] == ["SetGripper"]
    root = Planner([GripperIs("open")], [operator(place("A", 0.1), cost=1.0), cheap, operator(pick("A"))]).plan()
    assert next(node.kind for node in root.walk() if node.kind in ("Place", "SetGripper")) == "Place"


def test_the_order_in_which_the_operators_come_does_not_matter() -> None:
    actions: list[Action] = [pick("A"), place("A"), pick("B"), place("B", 0.4), *GRIPPER]
    goals: list[Condition] = [place("A").achieves, place("B", 0.4).achieves]
    assert plan(goals, actions) == plan(goals, actions[::-1])


@settings(max_examples=40, deadline=None)
@given(st.permutations("ABC"), st.booleans())
def test_every_plan_reaches_its_goal_in_the_abstract_world(order: list[str], guarded: bool) -> None:
    places = {name: place(name, 0.2 * number) for number, name in enumerate(order)}
    operators = [operator(action) for action in (*map(pick, order), *GRIPPER)]
    for number, name in enumerate(order):
        earlier = [places[other].achieves for other in order[:number]] if guarded else []
        operators.append(operator(places[name], *earlier))
    goals: list[Condition] = [*(places[name].achieves for name in order), GripperIs("open"), InGripper("none")]
    root = Planner(goals, operators).plan()
    world = Abstract(operators)
    assert reached(root, world, goals)
    assert [action for action in world.done if isinstance(action, Place)] == [places[name] for name in order]


def test_a_goal_that_was_undone_is_reached_again() -> None:
    operators = [operator(action) for action in (pick("A"), place("A"), *GRIPPER)]
    goals: list[Condition] = [place("A").achieves]
    root, world = Planner(goals, operators).plan(), Abstract(operators)
    assert reached(root, world, goals)
    world.state = INITIAL
    assert reached(root, world, goals)
    assert world.done.count(place("A")) == 2


def test_a_goal_that_holds_already_needs_no_action() -> None:
    operators = [operator(action) for action in (pick("A"), place("A"), *GRIPPER)]
    goals: list[Condition] = [place("A").achieves]
    world = Abstract(operators, INITIAL | set(goals))
    assert reached(Planner(goals, operators).plan(), world, goals)
    assert world.done == []


def test_what_an_action_undoes_to_its_left_comes_after_it() -> None:
    place_b = place("B", 0.4)
    held_first = Operator(place("A"), (InGripper("A"), place_b.achieves), place("A").postconditions, 20.0)
    operators = [held_first, *(operator(action) for action in (pick("A"), pick("B"), place_b, *GRIPPER))]
    goals: list[Condition] = [place("A").achieves]
    root, world = Planner(goals, operators).plan(), Abstract(operators)
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
def test_a_goal_that_no_plan_reaches_is_refused(goals: list[Condition]) -> None:
    actions = [pick("A"), pick("B"), place("A"), place("A", 0.3), *GRIPPER]
    with pytest.raises(NothingLearnedError, match="does not reach the goal"):
        plan(goals, actions)
