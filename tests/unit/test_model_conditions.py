"""Conditions and which of them exclude each other (paper, section III-B, Table II)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from learner.errors import ModelError
from learner.model import Condition, GripperIs, InGripper, ObjectAt, ObjectRoughlyAt, compatible

OBJECTS = st.sampled_from(["A", "B"])
FRAMES = st.sampled_from(["base", "box"])
POSITIONS = st.sampled_from([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)])
CONDITIONS: st.SearchStrategy[Condition] = st.one_of(
    st.builds(GripperIs, st.sampled_from(["open", "closed"])),
    st.builds(InGripper, OBJECTS | st.just("none")),
    st.builds(ObjectAt, OBJECTS, FRAMES, POSITIONS, st.sampled_from([0.02, 0.05])),
    st.builds(ObjectRoughlyAt, OBJECTS, FRAMES, POSITIONS),
)
HERE, THERE = (0.0, 0.0, 0.0), (0.1, 0.0, 0.0)


@given(CONDITIONS, CONDITIONS)
def test_compatibility_is_symmetric(a: Condition, b: Condition) -> None:
    assert compatible(a, b) == compatible(b, a)


@given(CONDITIONS)
def test_every_condition_is_compatible_with_itself(condition: Condition) -> None:
    assert compatible(condition, condition)


TABLE_II: list[tuple[Condition, Condition, bool]] = [
    (InGripper("A"), InGripper("B"), False),
    (InGripper("A"), InGripper("none"), False),
    (InGripper("none"), InGripper("none"), True),
    (GripperIs("open"), GripperIs("closed"), False),
    (GripperIs("open"), GripperIs("open"), True),
    (ObjectAt("A", "base", HERE), ObjectAt("A", "base", THERE), False),
    (ObjectAt("A", "base", HERE), ObjectAt("A", "box", HERE), False),
    (ObjectAt("A", "base", HERE), ObjectAt("B", "base", THERE), True),
    (ObjectAt("A", "base", HERE), ObjectAt("B", "base", HERE), True),
    (ObjectRoughlyAt("A", "base", HERE), ObjectRoughlyAt("A", "base", THERE), False),
    (ObjectRoughlyAt("A", "base", HERE), ObjectRoughlyAt("B", "base", THERE), True),
    (ObjectAt("A", "base", HERE), ObjectRoughlyAt("A", "base", THERE), False),
    (ObjectAt("A", "base", HERE), ObjectRoughlyAt("A", "base", HERE), True),
    (ObjectAt("A", "base", HERE), ObjectRoughlyAt("B", "base", THERE), True),
    (GripperIs("open"), InGripper("A"), False),
    (GripperIs("open"), InGripper("none"), True),
    (GripperIs("closed"), InGripper("A"), True),
    (GripperIs("closed"), InGripper("none"), True),
    (GripperIs("open"), ObjectAt("A", "base", HERE), True),
    (InGripper("A"), ObjectAt("B", "base", HERE), True),
]


@pytest.mark.parametrize(("a", "b", "together"), TABLE_II, ids=lambda value: repr(value)[:60])
def test_table_two_is_kept_row_by_row(a: Condition, b: Condition, together: bool) -> None:
    assert compatible(a, b) is together
    assert compatible(b, a) is together


@given(CONDITIONS, CONDITIONS)
def test_only_the_gripper_or_one_and_the_same_object_can_exclude(a: Condition, b: Condition) -> None:
    places = (ObjectAt, ObjectRoughlyAt)
    if isinstance(a, places) and isinstance(b, places) and a.object != b.object:
        assert compatible(a, b)
    if isinstance(a, places) != isinstance(b, places):
        assert compatible(a, b)


def test_the_radii_are_those_of_the_paper() -> None:
    assert ObjectAt("A", "base", HERE).radius == 0.05
    assert ObjectRoughlyAt("A", "base", HERE).radius == 0.10


def test_a_gripper_is_open_or_closed_and_nothing_else() -> None:
    with pytest.raises(ModelError, match="ajar"):
        GripperIs("ajar")  # type: ignore[arg-type]
