"""What is done with any part of a kind, or otherwise in some demonstrations, is doubted or asked about."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from support_demonstrations import Put, Script, scattered, scripted

from learner.learned import Learned
from learner.learning import learn
from learner.model import ObjectShape, Pose, Scene

Start = Mapping[str, Pose]
Made = Callable[[Start, int, np.random.Generator], Script]
CUBE, SCREW = ObjectShape((0.05, 0.05, 0.05), "cube"), ObjectShape((0.03, 0.03, 0.03), "cube", kind="screw")
PART, TRAY = ObjectShape((0.08, 0.04, 0.04)), ObjectShape((0.3, 0.12, 0.02))
BIN = ObjectShape((0.3, 0.3, 0.08), open=True)
SLOTS = ((-0.1, 0.0, 0.035), (0.0, 0.0, 0.035), (0.1, 0.0, 0.035))


def learned(shapes: Mapping[str, ObjectShape], made: Made, count: int, begins: float | None = None) -> Learned:
    """From scattered starts; with `begins` B starts at that yaw of the tray."""
    scene, rng, found = Scene(shapes, ((0.15, 0.85), (-0.55, 0.55))), np.random.default_rng(6), []
    for number in range(count):
        start = scattered(list(shapes), rng)
        if begins is not None:
            x, y, z = start["B"].position
            start["B"] = Pose((x, y, z), (start["tray"] @ Pose((0.0, 0.0, 0.0), about_z(begins))).quaternion_xyzw)
        found.append(scripted(start, made(start, number, rng), f"d{number}", rng=rng, scene=scene))
    return learn(found)


def about_z(yaw: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def turned(rng: np.random.Generator) -> float:
    return float(rng.uniform(-3, 3))


def into_the_bin(start: Start, number: int, rng: np.random.Generator) -> Script:
    return [Put(name, "bin", (*rng.normal(0, 0.02, 2), 0.0), "drop", 0.1) for name in start if name != "bin"]


def each_to_its_slot(names: Sequence[str]) -> Made:
    return lambda start, number, rng: [Put(n, "tray", at, yaw=0.0) for n, at in zip(names, SLOTS, strict=True)]


def any_to_any_slot(names: Sequence[str]) -> Made:
    def made(start: Start, number: int, rng: np.random.Generator) -> Script:
        order = [*names[number % 3 :], *names[: number % 3]]
        return [Put(name, "tray", at, yaw=turned(rng)) for name, at in zip(order, SLOTS, strict=True)]

    return made


def two_of_three(start: Start, number: int, rng: np.random.Generator) -> Script:
    names = ["s1", "s2", "s3"]
    del names[number % 3]
    return [Put(name, "tray", at, yaw=turned(rng)) for name, at in zip(names, SLOTS, strict=False)]


SCREWS = {"s1": SCREW, "s2": SCREW, "s3": SCREW}
CUBES = {"A": CUBE, "B": CUBE, "C": CUBE}


@pytest.mark.parametrize("count", [3, 6, 12])
@pytest.mark.parametrize(
    ("shapes", "made"),
    [({**SCREWS, "bin": BIN}, into_the_bin), ({**SCREWS, "tray": TRAY}, two_of_three)],
    ids=["all into a bin", "any two of three"],
)
def test_a_kind_whose_members_are_treated_alike_is_doubted(
    shapes: Mapping[str, ObjectShape], made: Made, count: int
) -> None:
    (found,) = (doubt for doubt in learned(shapes, made, count).doubts if doubt.what == "kind")
    assert found.sentence.startswith("s1, s2 and s3 are all of kind screw and were treated alike in each of")
    assert "show it once with another screw" in found.sentence
    assert len(found.demonstrations) == count


def test_a_kind_of_which_each_has_its_own_place_is_not() -> None:
    assert learned({**SCREWS, "tray": TRAY}, each_to_its_slot(["s1", "s2", "s3"]), 4).doubts == ()


def test_objects_that_no_kind_joins_are_not_either() -> None:
    plain = {name: replace(shape, kind=None) for name, shape in SCREWS.items()}
    assert learned({**plain, "bin": BIN}, into_the_bin, 4).doubts == ()


@pytest.mark.parametrize("count", [3, 6, 12])
def test_parts_that_look_alike_and_change_places_are_doubted_or_asked_about(count: int) -> None:
    found = learned({**CUBES, "tray": TRAY}, any_to_any_slot("ABC"), count)
    assert found.doubts
    noted = [number for number in range(count) if any(f"demonstration d{number}," in note for note in found.notes)]
    assert len(noted) < count


def test_a_place_that_two_use_one_after_the_other_is_no_exchange() -> None:
    def made(start: Start, number: int, rng: np.random.Generator) -> Script:
        beside = (0.0, 0.12, 0.0)
        return [Put("A", "C", beside), Put("C", "A", beside), Put("B", "C", beside)]

    found = learned(CUBES, made, 4)
    assert "kind" not in {doubt.what for doubt in found.doubts}


def elsewhere_in(which: Sequence[int]) -> Made:
    def made(start: Start, number: int, rng: np.random.Generator) -> Script:
        return [Put("A", "B" if number in which else "tray", (0.0, 0.0, 0.05), yaw=turned(rng))]

    return made


@pytest.mark.parametrize(("count", "which", "asked"), [(3, [1], True), (8, [1, 5], True), (8, [1], False)])
def test_whether_an_exception_was_a_mistake_is_asked_unless_it_is_rare(
    count: int, which: Sequence[int], asked: bool
) -> None:
    found = learned({"A": CUBE, "B": CUBE, "tray": TRAY}, elsewhere_in(which), count)
    sentences = [each["sentence"] for each in found.report["questions"] if "was put elsewhere in" in each["sentence"]]
    assert len(sentences) == asked
    assert all(f"d{number}" in sentences[0] for number in which if asked)
    assert any("show it once more from a start as in d1" in sentence for sentence in sentences) == asked


def test_rare_exceptions_of_several_objects_are_asked_about_together() -> None:
    def made(start: Start, number: int, rng: np.random.Generator) -> Script:
        return [Put({1: "C", 4: "B"}.get(number, "A"), "tray", (0.0, 0.0, 0.035), yaw=turned(rng))]

    found = learned({**CUBES, "tray": TRAY}, made, 7)
    sentences = " ".join(each["sentence"] for each in found.report["questions"])
    assert "B was put elsewhere in d4" in sentences
    assert "C was put elsewhere in d1" in sentences


def test_an_orientation_that_most_share_and_the_tree_does_not_ask_for_is_doubted() -> None:
    def made(start: Start, number: int, rng: np.random.Generator) -> Script:
        return [Put("B", "tray", (0.0, 0.0, 0.03), yaw=turned(rng) if number % 4 == 3 else 0.7)]

    (found,) = learned({"B": PART, "tray": TRAY}, made, 8).doubts
    assert (found.what, found.object) == ("orientation", "B")
    assert "turned alike at tray in 6 of 8 demonstrations" in found.sentence


def test_an_orientation_that_nobody_had_to_change_is_asked_about() -> None:
    def made(start: Start, number: int, rng: np.random.Generator) -> Script:
        return [Put("B", "tray", (0.0, 0.0, 0.03), yaw=0.4)]

    found = learned({"B": PART, "tray": TRAY}, made, 4, begins=0.4)
    assert found.doubts == ()
    (question,) = found.report["questions"]
    assert question["show"] == "turn B before you begin"


def test_an_orientation_that_a_step_before_gave_is_not() -> None:
    def made(start: Start, number: int, rng: np.random.Generator) -> Script:
        first = Put("B", "tray", (0.0, 0.0, 0.03), yaw=0.4)
        return [first, Put("A", "tray", (0.1, 0.0, 0.035)), Put("B", "tray", (-0.1, 0.0, 0.03), yaw=0.4)]

    found = learned({"A": CUBE, "B": PART, "tray": TRAY}, made, 5)
    assert not any("turn B" in question["sentence"] for question in found.report["questions"])
