"""Targets: which time it is that a demonstration reaches one, and which of several rigid frames it is told in."""

from __future__ import annotations

import numpy as np
from support_demonstrations import BASE, ON_TOP, TABLE_M, Put, Script, at, scattered, scripted

from learner.inference.parameters import InferenceParameters
from learner.inference.understanding import Understanding, understand
from learner.learning import learn
from learner.model import Demonstration, Pose

AT_BOX, THERE = Put("B", "box", (0.0, 0.14, 0.0)), Put("A", "box", (0.14, 0.0, 0.0))
TWICE: Script = [AT_BOX, THERE, Put("B", "A", ON_TOP), AT_BOX]


def five(found_done: int, script: Script, shorter: Script) -> list[Demonstration]:
    """Five demonstrations; at the beginning of one, B is where it belongs already, and the script is shorter."""
    rng, shown = np.random.default_rng(3), []
    for number in range(5):
        start = scattered(["A", "B", "box"], rng, apart_m=0.25)
        if number == found_done:
            start["B"] = start["box"] @ Pose(AT_BOX.at)
        shown.append(scripted(start, shorter if number == found_done else script, f"d{number}", rng=rng))
    return shown


def samples_by_context(understood: Understanding) -> list[tuple[int, int]]:
    return [(t.context, len(t.members)) for t in understood.targets if (t.object, t.frame) == ("B", "box")]


def test_what_is_reached_once_is_matched_with_the_time_that_it_fits() -> None:
    without_first = five(2, TWICE, TWICE[1:])
    assert samples_by_context(understand(without_first, InferenceParameters())) == [(0, 4), (1, 5)]
    learned = learn(without_first)
    assert len(learned.report["groups"]) == 1
    assert learned.tree.nodes == learn(five(9, TWICE, TWICE)).tree.nodes


def test_one_demonstration_that_does_it_twice_makes_no_second_context() -> None:
    once: Script = [AT_BOX, THERE]
    understood = understand(five(2, once, TWICE[1:]), InferenceParameters())
    assert samples_by_context(understood) == [(0, 5)]
    assert len(understood.groups) == 1


def test_what_stands_upon_an_object_is_told_in_its_frame_though_another_is_rigid_with_it() -> None:
    script: Script = [Put("A", "box", (0.0, 0.12, 0.0)), Put("B", "A", ON_TOP)]
    for seed in range(8):
        rng = np.random.default_rng(seed)
        shown = [scripted(scattered(["A", "B", "box"], rng), script, f"d{n}", rng=rng) for n in range(3)]
        (target,) = (t for t in understand(shown, InferenceParameters()).targets if t.object == "B")
        assert target.frame == "A"
        assert target.tied == {"box"}
        assert target.certainty > 0.95


def test_what_was_moved_on_fixes_nothing_any_more() -> None:
    """C stands at a spot of the base, later in the box: that does not make the box rigid with the base."""
    script: Script = [
        Put("C", BASE, (0.3, 0.3, TABLE_M)),
        Put("B", BASE, (0.3, 0.0, TABLE_M)),
        Put("C", "box", (0.0, -0.14, 0.0)),
        Put("A", "box", (0.0, 0.14, 0.0)),
    ]
    rng, shown = np.random.default_rng(4), []
    for number in range(3):
        start = {**scattered(["A", "B", "C"], rng), "box": at(0.6, -0.2)}
        shown.append(scripted(start, script, f"d{number}", rng=rng))
    (target,) = (t for t in understand(shown, InferenceParameters()).targets if t.object == "A")
    assert BASE not in target.tied
    assert target.certainty < 0.95
    (question,) = (q for q in learn(shown).report["questions"] if q["action"] == "place A")
    assert {question["frame"], question["rival"]} == {"box", BASE}


ASIDE: Script = [
    Put("A", "box", (0.0, 0.14, 0.0)),
    Put("B", "box", (0.14, 0.0, 0.0)),
    Put("A", BASE, (0.4, 0.1, TABLE_M)),
]


def test_to_stop_early_once_is_not_another_goal() -> None:
    rng = np.random.default_rng(6)
    starts = [scattered(["A", "B", "box"], rng, apart_m=0.25) for _ in range(5)]
    shown = [scripted(start, ASIDE[: 3 - (n == 3)], f"d{n}", rng=rng) for n, start in enumerate(starts)]
    learned = learn(shown)
    (group,) = learned.report["groups"]
    assert sorted(group["goal"]) == [f"A at {BASE}", "B at box"]
    assert any("d3 ends as no others do" in note for note in learned.notes)


def test_goals_of_which_none_is_shared_by_enough_are_all_kept() -> None:
    rng = np.random.default_rng(6)
    starts = [scattered(["A", "B", "box"], rng, apart_m=0.25) for _ in range(2)]
    shown = [scripted(start, [ASIDE[n]], f"d{n}", rng=rng) for n, start in enumerate(starts)]
    assert len(understand(shown, InferenceParameters()).groups) == 2


def test_a_last_move_that_happens_to_be_short_is_part_of_the_task() -> None:
    rng, shown = np.random.default_rng(8), []
    for number in range(4):
        start = scattered(["A", "B", "box"], rng, apart_m=0.25)
        if number == 1:
            start["box"] = at(0.4, -0.01)
        shown.append(scripted(start, ASIDE, f"d{number}", rng=rng))
    understood = understand(shown, InferenceParameters())
    assert {(t.frame, len(t.members)) for t in understood.targets if t.object == "A"} == {("box", 4), (BASE, 4)}
    assert len(understood.groups) == 1


def test_of_frames_that_the_task_keeps_rigid_the_likelier_is_chosen() -> None:
    script: Script = [Put("A", BASE, (0.5, 0.0, TABLE_M)), Put("B", "A", (0.17, 0.0, 0.0))]
    chosen = set()
    for seed in range(30):
        rng = np.random.default_rng(seed)
        shown = [scripted(scattered(["A", "B"], rng), script, f"d{n}", rng=rng, hand_m=0.004) for n in range(3)]
        (target,) = (t for t in understand(shown, InferenceParameters()).targets if t.object == "B")
        assert target.tied | {target.frame} == {"A", BASE}
        assert target.frames[target.frame] == max(target.frames.values())
        chosen.add(target.frame)
    assert chosen == {"A", BASE}
