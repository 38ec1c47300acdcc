"""Orders, guards and goals as the paper infers them (section III-D)."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from learner.inference.chains import orders
from learner.model import Action, Condition, Drop, GripperIs, InGripper, ObjectAt, Pick, Place, compatible
from learner.paper.constraints import goals, guards

DOWN, HAND = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.1)
SEQUENCES = st.lists(st.lists(st.sampled_from("abcd"), max_size=5), max_size=4)


def pick(name: str) -> Pick:
    return Pick(name, name, HAND, DOWN)


def place(name: str, x: float, frame: str = "base") -> Place:
    return Place(name, frame, HAND, DOWN, (x, 0.0, 0.0))


ACTIONS: dict[str, Action] = {
    "pick A": pick("A"),
    "pick B": pick("B"),
    "A left": place("A", 0.1),
    "A right": place("A", 0.2),
    "B left": place("B", 0.3),
    "B in box": Drop("B", "box", HAND, DOWN, (0.0, 0.0, 0.0)),
}
A_LEFT, A_RIGHT, B_LEFT = (ACTIONS[name].achieves for name in ("A left", "A right", "B left"))  # type: ignore[union-attr]


def positions(conditions: tuple[Condition, ...]) -> list[Condition]:
    return [condition for condition in conditions if isinstance(condition, ObjectAt)]


@given(SEQUENCES)
def test_an_order_is_seen_and_its_reverse_is_not(sequences: list[list[str]]) -> None:
    found = orders(sequences)
    for a, b in found:
        assert a != b
        assert (b, a) not in found
        assert any(a in s and b in s and s.index(a) < s.index(b) for s in sequences)


@given(SEQUENCES)
def test_the_order_of_the_demonstrations_has_no_meaning(sequences: list[list[str]]) -> None:
    assert orders(sequences[::-1]) == orders(sequences)


@given(SEQUENCES, st.lists(st.sampled_from("abcd"), max_size=5))
def test_one_more_demonstration_reverses_orders_but_never_makes_one_between_what_was_seen(
    sequences: list[list[str]], more: list[str]
) -> None:
    seen_together = {(a, b) for s in sequences for a, b in combinations(s, 2)}
    known = seen_together | {(b, a) for a, b in seen_together}
    assert {pair for pair in orders([*sequences, more]) if pair in known and pair not in orders(sequences)} == set()


def test_pairs_seen_in_both_orders_are_dropped() -> None:
    assert orders(["abc", "acb"]) == {("a", "b"), ("a", "c")}
    assert orders(["aba"]) == set()


def test_what_an_earlier_action_achieved_guards_a_later_one() -> None:
    sequence = ["pick A", "A left", "pick B", "B left"]
    assert guards("B left", ACTIONS, [sequence]) == (A_LEFT,)
    assert guards("pick B", ACTIONS, [sequence]) == (A_LEFT,)
    assert guards("pick A", ACTIONS, [sequence]) == ()


def test_what_came_before_in_one_demonstration_and_after_in_another_guards_nothing() -> None:
    one, other = ["A left", "B left"], ["B left", "A left"]
    assert guards("B left", ACTIONS, [one, other]) == ()
    assert guards("A left", ACTIONS, [one, other]) == ()


def test_of_two_conditions_that_conflict_the_one_closer_to_the_action_guards_it() -> None:
    assert guards("B left", ACTIONS, [["A left", "A right", "B left"]]) == (A_RIGHT,)
    assert guards("B left", ACTIONS, [["A right", "A left", "B left"]]) == (A_LEFT,)


def test_of_two_conditions_that_conflict_the_one_that_ever_came_closer_guards() -> None:
    far, close = ["A left", "pick A", "pick B", "B left"], ["A right", "B left"]
    assert guards("B left", ACTIONS, [far, close]) == (A_RIGHT,)
    assert guards("B left", ACTIONS, [close, far]) == (A_RIGHT,)


def test_of_two_conditions_that_conflict_and_came_as_close_the_first_one_guards() -> None:
    left, right = ["A left", "B left"], ["A right", "B left"]
    assert guards("B left", ACTIONS, [left, right]) == (A_LEFT,)
    assert guards("B left", ACTIONS, [right, left]) == (A_RIGHT,)


def test_a_guard_never_contradicts_the_action_itself() -> None:
    assert guards("A right", ACTIONS, [["A left", "pick A", "A right"]]) == ()


def test_guards_come_in_the_order_in_which_they_were_achieved() -> None:
    actions = {**ACTIONS, "C": place("C", 0.5)}
    assert guards("C", actions, [["B left", "A left", "C"]]) == (B_LEFT, A_LEFT)
    assert guards("C", actions, [["A left", "B left", "C"]]) == (A_LEFT, B_LEFT)


@given(st.lists(st.sampled_from(sorted(ACTIONS)), min_size=1, max_size=6))
def test_a_goal_is_compatible_with_itself_and_holds_what_the_last_action_achieved(sequence: list[str]) -> None:
    found = goals(sequence, ACTIONS)
    assert all(compatible(a, b) for a, b in combinations(found, 2))
    assert ACTIONS[sequence[-1]].postconditions <= set(found)
    assert len(set(found)) == len(found)


def test_the_last_place_of_an_object_is_its_goal() -> None:
    assert positions(goals(["A left", "B left", "A right"], ACTIONS)) == [B_LEFT, A_RIGHT]


def test_goals_come_as_they_were_achieved_and_the_grippers_last() -> None:
    found = goals(["pick A", "A left", "pick B", "B left"], ACTIONS)
    assert found[:2] == (A_LEFT, B_LEFT)
    assert set(found[2:]) == {GripperIs("open"), InGripper("none")}


def test_a_demonstration_that_ends_with_a_pick_ends_with_the_object_in_the_gripper() -> None:
    found = goals(["A left", "pick B"], ACTIONS)
    assert found == (A_LEFT, InGripper("B"), GripperIs("closed"))


@pytest.mark.parametrize("sequence", [["A left"], ["pick A", "A left"]])
def test_what_is_left_out_before_a_guard_does_not_matter(sequence: list[str]) -> None:
    assert positions(guards("B left", ACTIONS, [[*sequence, "B left"]])) == [A_LEFT]
