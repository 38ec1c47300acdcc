"""Radii follow what the cell sees and does with, and what must be told apart; what it cannot tell apart is said."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from support_demonstrations import Put, Script, scattered, scripted

from learner.learned import Learned
from learner.learning import learn
from learner.model import Demonstration, ObjectShape, Pose, Scene

PART, VISE = ObjectShape((0.06, 0.04, 0.04)), ObjectShape((0.12, 0.1, 0.06))
PLATE = ObjectShape((0.1, 0.07, 0.008))
PLATES = {"A": PLATE, "B": PLATE, "C": PLATE, "V": VISE}
ROOM = ((0.15, 0.85), (-0.55, 0.55))
UPON_M = 0.05
"""How high the part's origin is above the vise's when it lies upon it."""


def turned(rng: np.random.Generator) -> float:
    return float(rng.uniform(-3, 3))


def standing(shapes: Mapping[str, ObjectShape], rng: np.random.Generator) -> dict[str, Pose]:
    """Anywhere on the table, each upon it."""
    spots = scattered(list(shapes), rng)
    return {
        name: Pose((*spots[name].position[:2], shape.size_m[2] / 2), spots[name].quaternion_xyzw)
        for name, shape in shapes.items()
    }


Made = Callable[[np.random.Generator], Script]


def shown(
    shapes: Mapping[str, ObjectShape], made: Made, count: int = 5, accuracy_m: float | None = None
) -> list[Demonstration]:
    """In a cell of that accuracy, of 3 mm where it is not told."""
    scene = Scene(shapes, ROOM, accuracy_m, accuracy_m and math.radians(0.2))
    rng, noise_m, found = np.random.default_rng(4), accuracy_m or 0.003, []
    for number in range(count):
        start, name = standing(shapes, rng), f"d{number}"
        script = made(rng)
        found.append(scripted(start, script, name, "u1", rng, hand_m=noise_m, camera_m=noise_m / 2, scene=scene))
    return found


def in_vise(rng: np.random.Generator) -> Script:
    return [Put("A", "V", (0.02, 0.0, UPON_M), yaw=turned(rng))]


def in_pocket(deep_m: float) -> Made:
    return lambda rng: [Put("A", "V", (0.0, 0.0, UPON_M - deep_m), yaw=turned(rng))]


def stacked(_: np.random.Generator) -> Script:
    return [Put("A", "V", (0.0, 0.0, 0.034)), Put("B", "A", (0.0, 0.0, 0.008)), Put("C", "B", (0.0, 0.0, 0.008))]


def left_again(_: np.random.Generator) -> Script:
    here = (0.0, 0.0, UPON_M)
    return [Put("A", "V", here), Put("A", "V", (0.0, 0.2, 0.0)), Put("B", "V", here)]


def radii_m(learned: Learned) -> Sequence[float]:
    assert learned.draft is not None
    return [placement.radius for placement in learned.draft.placements.values()]


@pytest.mark.parametrize("count", [1, 2, 3, 10])
def test_a_part_36_mm_off_is_not_in_its_vise(count: int) -> None:
    radii = radii_m(learn(shown({"A": PART, "V": VISE}, in_vise, count)))
    assert radii
    assert all(0.02 <= radius < 0.03 for radius in radii)


@pytest.mark.parametrize(("accuracy_m", "least_m", "most_m"), [(0.0004, 0.001, 0.005), (0.006, 0.03, 0.05)])
def test_a_radius_follows_the_accuracy_of_the_cell(accuracy_m: float, least_m: float, most_m: float) -> None:
    (radius,) = radii_m(learn(shown({"A": PART, "V": VISE}, in_vise, accuracy_m=accuracy_m)))
    assert least_m < radius <= most_m


def test_a_fine_cell_tells_the_layers_of_thin_plates_apart() -> None:
    learned = learn(shown(PLATES, stacked, accuracy_m=0.0004), rehearsed=True)
    assert all(radius < 0.004 for radius in radii_m(learned))
    assert (learned.report["rehearsal"]["by_kind"]["shown"], learned.report["rehearsal"]["left_out"]) == ("5 of 5", {})
    assert learned.doubts == ()


def test_that_a_coarse_cell_cannot_is_said() -> None:
    doubts = learn(shown(PLATES, stacked)).doubts
    assert {doubt.object for doubt in doubts} == {"A", "B", "C"}
    assert all(doubt.what == "precision" and "accuracy_m" in doubt.sentence for doubt in doubts)
    assert " from the place of another object, and a cell that sees with 3 mm cannot tell" in doubts[0].sentence


def test_a_fine_cell_tells_a_part_in_its_pocket_from_one_upon_the_rim() -> None:
    learned = learn(shown({"A": PART, "V": VISE}, in_pocket(0.002), accuracy_m=0.0002))
    (radius,) = radii_m(learned)
    assert radius < 0.0018
    assert learned.doubts == ()


@pytest.mark.parametrize(("deep_m", "accuracy_m"), [(0.002, 0.0005), (0.012, None)])
def test_a_pocket_too_shallow_to_be_seen_is_said(deep_m: float, accuracy_m: float | None) -> None:
    (doubt,) = learn(shown({"A": PART, "V": VISE}, in_pocket(deep_m), accuracy_m=accuracy_m)).doubts
    assert (doubt.what, doubt.object) == ("precision", "A")
    assert "from the rim of V, should it not go in" in doubt.sentence


def test_a_container_has_no_rim_to_lie_upon() -> None:
    assert learn(shown({"A": PART, "V": replace(VISE, open=True)}, in_pocket(0.012))).doubts == ()


def test_a_place_that_was_left_before_another_came_there_need_not_be_told_apart() -> None:
    learned = learn(shown({"A": PART, "B": PART, "V": VISE}, left_again))
    assert all(radius > 0.02 for radius in radii_m(learned))
    assert not any(doubt.what == "precision" for doubt in learned.doubts)
