"""Actions and what holds before and after them (paper, Table I)."""

from __future__ import annotations

from itertools import combinations

import pytest

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

HAND, REST = (0.0, 0.0, 0.2), (0.0, 0.0, 0.03)
DOWN = (1.0, 0.0, 0.0, 0.0)
PICK = Pick("A", "A", HAND, DOWN)
PLACE = Place("A", "box", HAND, DOWN, REST, 0.03)
DROP = Drop("A", "box", HAND, DOWN, REST)
FREE = {GripperIs("open"), InGripper("none")}

TABLE_I: list[tuple[Action, set[Condition], set[Condition]]] = [
    (PICK, {GripperIs("open")}, {GripperIs("closed"), InGripper("A")}),
    (PLACE, {InGripper("A")}, {ObjectAt("A", "box", REST, 0.03), *FREE}),
    (DROP, {InGripper("A")}, {ObjectRoughlyAt("A", "box", REST), *FREE}),
    (SetGripper("open"), set(), FREE),
    (SetGripper("closed"), set(), {GripperIs("closed")}),
]


@pytest.mark.parametrize(("action", "before", "after"), TABLE_I, ids=lambda value: type(value).__name__)
def test_table_one_is_kept_row_by_row(action: Action, before: set[Condition], after: set[Condition]) -> None:
    assert action.preconditions == before
    assert action.postconditions == after


@pytest.mark.parametrize(("action", "before", "after"), TABLE_I, ids=lambda value: type(value).__name__)
def test_what_holds_together_before_or_after_an_action_is_compatible(
    action: Action, before: set[Condition], after: set[Condition]
) -> None:
    for conditions in (action.preconditions, action.postconditions):
        assert all(compatible(a, b) for a, b in combinations(conditions, 2))


@pytest.mark.parametrize("action", [PICK, PLACE, DROP], ids=lambda action: type(action).__name__)
def test_a_demonstrated_action_changes_what_was_needed_before_it(action: Action) -> None:
    assert any(not compatible(a, b) for a in action.preconditions for b in action.postconditions)


def test_what_is_achieved_is_the_rest_of_the_object_and_not_the_pose_of_the_hand() -> None:
    assert PLACE.achieves.position == DROP.achieves.position == REST
    assert PLACE.position == DROP.position == HAND


def test_a_placement_has_by_default_the_radii_of_the_paper() -> None:
    assert Place("A", "box", HAND, DOWN, REST).achieves.radius == 0.05
    assert Drop("A", "box", HAND, DOWN, REST).achieves.radius == 0.10
