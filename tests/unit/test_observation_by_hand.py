"""Demonstrations by hand: without a button, the gripper and what moved with it tell what was done."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments.demonstrator import demonstrate
from experiments.scenarios import SCENARIOS
from experiments.users import EXPERT
from support_demonstrations import at
from support_tape import Tape

from learner.errors import DemonstrationRefusedError
from learner.learning import learn
from learner.model import ActionPress, Demonstration, Pose, Recording
from learner.observation import observe
from learner.observation.corrections import Correction

TABLE = {"A": at(0.4, 0.2), "B": at(0.4, -0.2), "box": at(0.6, 0.0)}


def done(demonstration: Demonstration) -> list[tuple[str, str]]:
    return [(action.type, action.object) for action in demonstration.actions]


def by_hand(recording: Recording) -> Recording:
    return replace(recording, presses=())


@pytest.mark.parametrize("name", ["object_in_box", "tower_and_box", "hanoi", "sorting"])
def test_the_same_is_learned_by_hand_as_by_buttons(name: str) -> None:
    recordings = [demonstrate(SCENARIOS[name], np.random.default_rng([5, n]), EXPERT, n) for n in range(3)]
    pressed = [observe(recording) for recording in recordings]
    found = [observe(by_hand(recording)) for recording in recordings]
    assert [done(each) for each in found] == [done(each) for each in pressed]
    trees = [learn(each).report["actions"] for each in (pressed, found)]
    assert [(a["type"], a["object"], a["frame"]) for a in trees[0]] == [
        (a["type"], a["object"], a["frame"]) for a in trees[1]
    ]


def test_the_hand_stands_at_the_target_when_a_press_is_told() -> None:
    tape = Tape(TABLE)
    tape.pick("A").release("place", at(0.6, 0.0, 0.05))
    pressed, found = observe(tape.recording()), observe(by_hand(tape.recording()))
    for one, other in zip(pressed.actions, found.actions, strict=True):
        assert np.allclose(one.end_effector.position, other.end_effector.position, atol=1e-6)
        assert abs(one.stamp_ns - other.stamp_ns) < 0.5e9
    assert any(warning.startswith("no button was pressed") for warning in found.warnings)
    assert not any(warning.startswith("no button") for warning in pressed.warnings)


def test_the_height_of_the_fall_tells_place_from_drop() -> None:
    for fall_m, kind in ((0.0, "place"), (0.02, "place"), (0.06, "drop")):
        tape = Tape(TABLE)
        tape.pick("A").release("place", at(0.6, 0.0, 0.05), fall_m=fall_m)
        assert done(observe(by_hand(tape.recording()))) == [("pick", "A"), (kind, "A")]


def test_a_closing_that_takes_nothing_is_no_pick() -> None:
    tape = Tape(TABLE)
    tape.go(Pose((0.2, 0.4, 0.3), tape.hand.quaternion_xyzw)).grip("closed").wait(0.5)
    tape.go(Pose((0.2, 0.2, 0.3), tape.hand.quaternion_xyzw)).grip("open").wait(0.5)
    tape.reach("B").grip("closed").wait(0.5).grip("open").wait(0.5)
    tape.pick("A").release("place", at(0.6, 0.0, 0.05))
    assert done(observe(by_hand(tape.recording()))) == [("pick", "A"), ("place", "A")]


def test_what_lies_on_the_held_one_is_not_what_was_picked() -> None:
    tape = Tape({**TABLE, "B": at(0.4, 0.2, 0.075)})
    tape.pick("A", "B").release("place", at(0.6, 0.0, 0.05))
    assert done(observe(by_hand(tape.recording())))[0] == ("pick", "A")


def test_an_object_that_the_hand_hides_is_told_by_where_it_is_seen_next() -> None:
    tape = Tape(TABLE)
    tape.pick("A").hide("A").bring(at(0.6, 0.0, 0.05)).wait(0.2).grip("open").put("A", at(0.6, 0.0, 0.05)).wait(0.2)
    tape.go(Pose((0.3, 0.0, 0.4), tape.hand.quaternion_xyzw)).show("A").wait(1.0)
    assert done(observe(by_hand(tape.recording()))) == [("pick", "A"), ("place", "A")]


def test_a_gripper_that_chatters_releases_nothing() -> None:
    tape = Tape(TABLE)
    tape.pick("A").bring(at(0.5, 0.0, 0.2))
    held = dict(tape.grasped)
    tape.grip("open").wait(0.1).grip("closed").wait(0.1)
    tape.grasped = held
    tape.release("place", at(0.6, 0.0, 0.05))
    assert done(observe(by_hand(tape.recording()))) == [("pick", "A"), ("place", "A")]


def test_what_is_closed_from_the_beginning_holds_nobody_knows_what() -> None:
    tape = Tape(TABLE)
    tape.gripper = [replace(tape.gripper[0], state="closed")]
    tape.wait(0.5).grip("open").wait(0.5)
    tape.pick("A").release("place", at(0.6, 0.0, 0.05))
    assert done(observe(by_hand(tape.recording()))) == [("pick", "A"), ("place", "A")]


def test_a_pick_that_ends_the_recording_stays_a_pick() -> None:
    tape = Tape(TABLE)
    tape.pick("A").bring(at(0.6, 0.0, 0.2))
    assert done(observe(by_hand(tape.recording()))) == [("pick", "A")]


def test_where_nothing_moved_with_the_gripper_the_reason_says_so() -> None:
    tape = Tape(TABLE).wait(2.0)
    with pytest.raises(DemonstrationRefusedError, match="nor did the gripper close on anything"):
        observe(tape.recording())


def test_actions_that_were_all_taken_back_do_not_count() -> None:
    tape = Tape(TABLE)
    tape.pick("A").press("undo").release("place", at(0.6, 0.0, 0.05)).press("undo")
    assert done(observe(tape.recording())) == [("pick", "A"), ("place", "A")]


def test_a_signal_beside_what_was_done_by_hand_keeps_its_place() -> None:
    tape = Tape(TABLE)
    tape.pick("A").wait(0.5)
    tape.presses = [ActionPress(tape.now_ns, "signal", None, "door", True)]
    tape.release("place", at(0.6, 0.0, 0.05))
    tape.presses = tape.presses[:1]
    found = observe(tape.recording())
    assert [(action.step, action.type) for action in found.actions] == [(0, "pick"), (2, "place")]
    assert any("sets door to true" in warning for warning in found.warnings)


def test_what_was_told_by_hand_can_be_corrected() -> None:
    tape = Tape(TABLE)
    tape.pick("A").release("place", at(0.6, 0.0, 0.05))
    tape.pick("B").release("place", at(0.3, 0.3))
    corrections = [Correction(1, "drop"), Correction(2, "undo"), Correction(3, "undo")]
    assert done(observe(by_hand(tape.recording()), corrections=corrections)) == [("pick", "A"), ("drop", "A")]
