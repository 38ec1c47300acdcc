"""The simulator of the paper's planner: points that move one at a time (section III-C)."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from learner.model import (
    Action,
    Condition,
    Drop,
    GripperIs,
    InGripper,
    ObjectAt,
    ObjectRoughlyAt,
    Pick,
    Place,
    SetGripper,
    compatible,
)
from learner.paper.pointworld import PointWorld

DOWN, HAND = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.1)
NOTHING_DONE: set[Condition] = {GripperIs("open"), InGripper("none")}


def pick(name: str) -> Pick:
    return Pick(name, name, HAND, DOWN)


def place(name: str, frame: str, x: float = 0.2) -> Place:
    return Place(name, frame, HAND, DOWN, (x, 0.0, 0.0))


def drop(name: str, frame: str) -> Drop:
    return Drop(name, frame, HAND, DOWN, (0.0, 0.3, 0.0))


def world(*actions: Action) -> PointWorld:
    found = PointWorld(["A", "B", "base", "box"])
    for action in actions:
        found.do(action)
    return found


MOVES = st.sampled_from(
    [
        (pick("A"), place("A", "base")),
        (pick("A"), place("A", "B", 0.4)),
        (pick("B"), place("B", "A")),
        (pick("B"), drop("B", "box")),
        (pick("A"), SetGripper("open")),
        (SetGripper("closed"),),
        (SetGripper("open"),),
    ]
)
CONDITIONS: set[Condition] = {
    *NOTHING_DONE,
    GripperIs("closed"),
    InGripper("A"),
    InGripper("B"),
    place("A", "base").achieves,
    place("A", "B", 0.4).achieves,
    place("B", "A").achieves,
    drop("B", "box").achieves,
}


def holding(found: PointWorld) -> set[Condition]:
    return {condition for condition in CONDITIONS if found.holds(condition)}


@given(st.lists(MOVES, max_size=6))
def test_an_action_brings_about_its_postconditions_whatever_was_done_before(moves: list[tuple[Action, ...]]) -> None:
    found = world()
    for action in (action for move in moves for action in move):
        found.do(action)
        assert all(found.holds(condition) for condition in action.postconditions)


@given(st.lists(MOVES, max_size=6))
def test_one_object_at_one_gripper_never_contradicts_itself(moves: list[tuple[Action, ...]]) -> None:
    found = holding(world(*(action for move in moves for action in move)))
    gripper = {condition for condition in found if isinstance(condition, GripperIs | InGripper)}
    assert all(compatible(a, b) for a in gripper for b in gripper)


def test_at_the_beginning_the_gripper_is_open_and_nothing_lies_where_it_is_asked_for() -> None:
    assert holding(world()) == NOTHING_DONE
    begun = world(pick("A"), place("A", "base"))
    begun.reset()
    assert holding(begun) == NOTHING_DONE


def test_what_is_held_is_nowhere_nor_is_anything_in_its_frame() -> None:
    found = world(pick("A"), place("A", "base"), pick("B"), place("B", "A"))
    assert found.holds(place("A", "base").achieves)
    assert found.holds(place("B", "A").achieves)
    found.do(pick("A"))
    assert holding(found) == {GripperIs("closed"), InGripper("A")}


def test_what_was_placed_in_the_frame_of_an_object_does_not_move_with_it() -> None:
    found = world(pick("B"), place("B", "A"), pick("A"), place("A", "base"))
    assert not found.holds(place("B", "A").achieves)
    assert found.holds(place("A", "base").achieves)


def test_two_positions_nearer_than_the_radius_are_one() -> None:
    found = world(pick("A"), place("A", "base", 0.2))
    assert found.holds(ObjectAt("A", "base", (0.2, 0.049, 0.0)))
    assert not found.holds(ObjectAt("A", "base", (0.2, 0.051, 0.0)))


def test_of_what_was_dropped_the_height_does_not_matter() -> None:
    found = world(pick("B"), drop("B", "box"))
    assert found.holds(ObjectRoughlyAt("B", "box", (0.0, 0.39, 5.0)))
    assert not found.holds(ObjectRoughlyAt("B", "box", (0.0, 0.41, 0.0)))
    assert not found.holds(ObjectAt("B", "box", (0.0, 0.3, 0.06)))


def test_what_the_gripper_just_lets_go_lies_where_nothing_asks_for_it() -> None:
    for letting_go in (SetGripper("open"), pick("B"), place("B", "base")):
        found = world(pick("A"), place("A", "base"), pick("A"), letting_go)
        assert not found.holds(place("A", "base").achieves)
        assert not found.holds(InGripper("A"))


def test_closing_a_closed_gripper_changes_nothing() -> None:
    found = world(pick("A"), SetGripper("closed"))
    assert holding(found) == {GripperIs("closed"), InGripper("A")}
