"""Trees broken by hand as a programmer might: each is refused by the proof, and the sound one beside it is not."""

from __future__ import annotations

import numpy as np
import pytest

from learner.model import (
    Definition,
    Drop,
    GripperIs,
    InGripper,
    Node,
    ObjectAt,
    ObjectRoughlyAt,
    Pick,
    Place,
    SetGripper,
    Tree,
)
from learner.model.tree import fallback, leaf, sequence
from learner.proof.prover import prove

DOWN = (1.0, 0.0, 0.0, 0.0)
ZERO = (0.0, 0.0, 0.0)
UPON = (0.0, 0.0, 0.05)
SPOT = (0.4, 0.4, 0.025)
LEFT, RIGHT = (-0.04, 0.0, 0.0), (0.04, 0.0, 0.0)

OPENED = fallback(leaf(GripperIs("open")), leaf(SetGripper("open")))


def inverted(condition: ObjectAt | ObjectRoughlyAt) -> Node:
    return Node("Inverter", (), (leaf(condition),))


def emptied(*names: str) -> Node:
    """The gripper open: what it holds is put on the spot."""
    spots = [sequence(leaf(InGripper(name)), leaf(Place(name, "base", SPOT, DOWN, SPOT))) for name in names]
    return fallback(leaf(GripperIs("open")), *spots, leaf(SetGripper("open")))


def picked(name: str, opened: Node | None = None) -> Node:
    grasped = leaf(Pick(name, name, ZERO, DOWN))
    return fallback(leaf(InGripper(name)), sequence(opened or OPENED, grasped))


def upon(upper: str, lower: str) -> Place:
    return Place(upper, lower, UPON, DOWN, UPON, 0.024)


def uncovered(name: str, by: str, *others: str) -> Node:
    lifted = sequence(emptied(name, by, *others), leaf(Pick(by, by, ZERO, DOWN)))
    return fallback(inverted(ObjectAt(by, name, UPON, 0.035)), lifted)


def step(place: Place | Drop, *before: Node, condition: Node | None = None, opened: Node | None = None) -> Node:
    name = place.object
    return fallback(condition or leaf(place.achieves), sequence(*before, picked(name, opened), leaf(place)))


D_ON_E = step(upon("D", "E"), uncovered("D", "F"), opened=emptied("F"))
F_ON_D = step(upon("F", "D"), opened=emptied("D"))
TOWER = sequence(D_ON_E, F_ON_D)


def refuted(root: Node, task: Node | None = None) -> str | None:
    return prove(Tree(Definition("t", root)), "base", np.random.default_rng(0), task, levels=5).counterexample


def closed_on_nothing() -> Node:
    """Picks without opening the gripper before."""
    return fallback(leaf(InGripper("D")), leaf(Pick("D", "D", ZERO, DOWN)))


def test_the_sound_tower_is_proven() -> None:
    assert refuted(TOWER) is None
    assert refuted(TOWER, TOWER) is None


BROKEN = {
    "wrong order in a tower": (sequence(F_ON_D, D_ON_E), "never to the goal"),
    "missing SetGripper": (
        sequence(
            fallback(
                leaf(upon("D", "E").achieves),
                sequence(uncovered("D", "F"), closed_on_nothing(), leaf(upon("D", "E"))),
            ),
            F_ON_D,
        ),
        "hand is not ready",
    ),
    "missing Pick": (
        sequence(fallback(leaf(upon("D", "E").achieves), leaf(upon("D", "E"))), F_ON_D),
        "hand is not ready",
    ),
    "missing goal": (D_ON_E, "ends before the task is done"),
    "Fallback where a Sequence belongs": (fallback(D_ON_E, F_ON_D), "ends before the task is done"),
    "Fallback of hold and place": (
        sequence(
            fallback(
                leaf(upon("D", "E").achieves), uncovered("D", "F"), picked("D", emptied("F")), leaf(upon("D", "E"))
            ),
            F_ON_D,
        ),
        "never to the goal",
    ),
    "condition of the wrong object": (
        sequence(
            step(upon("D", "E"), uncovered("D", "F"), condition=leaf(upon("F", "E").achieves), opened=emptied("F")),
            F_ON_D,
        ),
        "",
    ),
    "covered object picked": (sequence(step(upon("D", "E"), opened=emptied("F")), F_ON_D), "never to the goal"),
    "goal pursued though it is reached": (
        sequence(sequence(uncovered("D", "F"), picked("D", emptied("F")), leaf(upon("D", "E"))), F_ON_D),
        "",
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_tower_is_refused(fault: str) -> None:
    root, because = BROKEN[fault]
    found = refuted(root, TOWER)
    assert found is not None
    assert because in found


@pytest.mark.parametrize(("radius_m", "sound"), [(0.035, True), (0.1, False)])
def test_a_drop_that_counts_as_done_upon_the_place_of_another_object_is_refused(radius_m: float, sound: bool) -> None:
    beside = Place("B", "box", RIGHT, DOWN, RIGHT, 0.035)
    free = inverted(ObjectAt("A", "box", RIGHT, 0.035))
    tree = sequence(step(Drop("A", "box", LEFT, DOWN, LEFT, radius_m)), step(beside, free))
    found = refuted(tree)
    assert (found is None) == sound
    assert sound or "nothing can be done" in str(found)


BESIDE = Place("A", "R", (0.12, 0.0, 0.0), DOWN, (0.12, 0.0, 0.0), 0.03)
ON_X = ObjectAt("R", "X", UPON, 0.035)


def test_what_is_placed_beside_a_raised_reference_falls_and_so_the_reference_is_taken_down_first() -> None:
    down = fallback(inverted(ON_X), sequence(emptied("A", "R", "X"), leaf(Pick("R", "R", ZERO, DOWN))))
    placed = step(BESIDE, uncovered("A", "X", "R"), opened=emptied("R", "X"))
    assert refuted(sequence(down, placed)) is None
    found = refuted(sequence(placed, down))
    assert found is not None
    assert "R at X" in found


def test_letting_what_covers_go_in_the_air_is_no_way_to_uncover() -> None:
    """It may fall back to where it was."""
    thrown = fallback(inverted(ObjectAt("F", "D", UPON, 0.035)), sequence(OPENED, leaf(Pick("F", "F", ZERO, DOWN))))
    found = refuted(sequence(step(upon("D", "E"), thrown), step(upon("F", "D"))))
    assert found is not None
    assert "never to the goal" in found


def test_an_action_that_fails_wherever_it_is_begun_is_refused_even_if_another_way_is_found() -> None:
    """D is put upon itself before it is put on E."""
    useless = Place("D", "D", UPON, DOWN, UPON)
    found = refuted(sequence(fallback(leaf(upon("D", "E").achieves), sequence(picked("D"), fallback(
        leaf(useless), leaf(upon("D", "E")))))))  # fmt: skip
    assert found is not None
    assert "wherever it is begun" in found
