"""The rules by which a press is judged: what stands, what contradicts, what no cell could believe, what went astray."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from support_demonstrations import BASE, GRASP, at
from support_tape import Tape

from learner.errors import DemonstrationRefusedError
from learner.model import ActionPress, ObjectShape, Pose, Recording, Scene
from learner.observation import observe, warnings_of
from learner.observation.doubts import doubts_of
from learner.observation.presses import Judgement, judge, standing
from learner.observation.surroundings import Held, Surroundings

A, BOX, GOAL = at(0.40, 0.10), at(0.50, -0.20, 0.04, yaw=0.5), at(0.52, -0.22, 0.03, yaw=0.4)


def pressed(*types: str) -> list[ActionPress]:
    return [ActionPress(number, type_, None) for number, type_ in enumerate(types)]


def left(*types: str) -> list[tuple[int, str]]:
    return [(each.step, each.press.type) for each in standing(pressed(*types))]


def judged(recording: Recording) -> list[Judgement]:
    """Every press of a recording that stands, judged as the recorder does: with what follows, if it contradicts."""
    around = Surroundings(recording.tracks, recording.objects, recording.end_effector_frame, recording.scene)
    held: Held | None = None
    found = []
    for each in standing(recording.presses):
        found.append(judge(each, held, around, recording.gripper))
        held = found[-1].held
    return found


# What stands


def test_undo_takes_back_the_newest_that_is_not_taken_back_yet() -> None:
    assert left("pick", "undo", "pick", "place") == [(0, "pick"), (1, "place")]
    assert left("pick", "place", "undo", "undo", "pick") == [(0, "pick")]
    assert left("undo", "pick") == [(0, "pick")]
    assert left("pick", "signal", "undo", "drop") == [(0, "pick"), (1, "drop")]


def test_an_action_that_was_taken_back_does_not_count() -> None:
    tape = Tape({"A": A, "B": at(0.3, 0.3), "box": BOX}).reach("B").press("pick", "B").wait(0.5).press("undo")
    found = observe(tape.pick("A").release("place", GOAL).recording())
    assert [(action.step, action.type, action.object) for action in found.actions] == [
        (0, "pick", "A"),
        (1, "place", "A"),
    ]
    assert list(warnings_of(found)) == []


def test_a_contradiction_that_was_taken_back_does_not_count() -> None:
    tape = Tape({"A": A, "box": BOX}).press("place").wait(0.3).press("undo").pick("A").release("place", GOAL)
    assert len(observe(tape.recording()).actions) == 2


def test_a_recording_of_which_everything_was_taken_back_is_refused() -> None:
    with pytest.raises(DemonstrationRefusedError, match="every action was taken back"):
        observe(Tape({"A": A}).reach("A").press("pick", "A").press("undo").wait(0.5).recording())


# Signals


def signal(tape: Tape, name: str | None = "door", value: bool | float | str | None = True) -> Tape:
    tape.presses.append(ActionPress(tape.now_ns, "signal", None, name, value))
    return tape


def test_a_signal_is_no_move_and_is_told_as_a_doubt() -> None:
    found = observe(signal(Tape({"A": A, "box": BOX}).pick("A")).release("place", GOAL).recording())
    assert [(action.step, action.type) for action in found.actions] == [(0, "pick"), (2, "place")]
    (doubt,) = doubts_of([found, replace(found, demonstration_id="d2")])
    assert (doubt.demonstrations, doubt.object, doubt.what) == (("d1", "d2"), None, "signal")
    assert "action 1 (signal) sets door to true" in doubt.sentence


@pytest.mark.parametrize(("name", "value"), [(None, True), ("a b", 1), ("door", None)])
def test_a_signal_without_a_name_or_a_value_contradicts(name: str | None, value: bool | float | None) -> None:
    with pytest.raises(DemonstrationRefusedError, match=r"action 1 \(signal\)"):
        observe(signal(Tape({"A": A, "box": BOX}).pick("A"), name, value).release("place", GOAL).recording())


def test_signals_alone_are_no_demonstration() -> None:
    with pytest.raises(DemonstrationRefusedError, match="nothing but signals"):
        observe(signal(Tape({"A": A})).wait(0.5).recording())


# What a cell could believe


def gripped(grasp: Pose, scene: Scene | None = None) -> Recording:
    """A is gripped at a pose in its own frame, and placed."""
    tape = Tape({"A": A, "B": at(0.2, -0.3), "box": BOX}).go(A @ grasp).wait(0.4)
    tape.press("pick", "A").wait(0.15).grip("closed", "A").wait(0.3)
    return tape.release("place", GOAL).recording(scene=scene)


def beside(distance_m: float) -> Pose:
    return Pose((distance_m, 0.0, 0.0), GRASP.quaternion_xyzw)


LONG = Scene({"A": ObjectShape((0.24, 0.03, 0.05))})


def test_what_is_gripped_far_from_its_origin_is_a_doubt_unless_the_scene_tells_its_body() -> None:
    found = observe(gripped(beside(0.11)))
    (doubt,) = doubts_of([found])
    assert (doubt.demonstrations, doubt.object, doubt.what) == (("d1",), "A", "held")
    assert "A is 11 cm from the end-effector (by its origin" in doubt.sentence
    assert [warning for warning in warnings_of(found) if "InGripper of A could never hold" in warning]
    assert doubts_of([observe(gripped(beside(0.11), LONG))]) == ()


def test_what_is_gripped_far_from_its_body_is_a_doubt_by_its_size() -> None:
    (doubt,) = doubts_of([observe(gripped(beside(0.19), LONG))])
    assert "7 cm from the end-effector (by the sizes of the scene)" in doubt.sentence


def test_a_pick_beside_another_object_is_doubtful_as_the_cell_would_believe_that_one() -> None:
    tape = Tape({"A": A, "B": at(0.46, 0.10)}).reach("A").press("pick", "B").wait(0.15).grip("closed", "B").wait(0.5)
    (pick,) = judged(tape.recording())
    assert (pick.verdict, pick.object) == ("doubtful", "B")
    assert "B is 6.08 cm from the end-effector" in str(pick.reason)
    tape = Tape({"A": A, "B": at(0.43, 0.10)}).reach("A").press("pick", "B").wait(0.15).grip("closed", "B").wait(0.5)
    assert "would believe that it holds A" in str(judged(tape.recording())[0].reason)


# What is seen elsewhere than in the hand


def left_behind() -> Tape:
    """The hand holds A, whose stale detection stays, ever fresh, where A was picked."""
    tape = Tape({"A": A, "box": BOX}).pick("A")
    held, tape.grasped = dict(tape.grasped), {}
    assert set(held) == {"A"}
    return tape.go(GOAL @ GRASP).wait(0.4).press("place", "A").wait(0.15)


def test_a_detection_that_stayed_behind_is_no_rest_and_the_object_is_where_the_hand_carries_it() -> None:
    found = observe(left_behind().grip("open").wait(1.5).recording())
    place = found.actions[1]
    away_cm = 100 * math.dist(A.position, GOAL.position)
    assert math.dist(place.objects["A"].position, GOAL.position) < 1e-3
    assert math.dist((place.rest or {})[BASE].position, GOAL.position) < 1e-3
    assert not place.rest_seen
    assert place.warnings[0].startswith(f"A was held, but was seen {away_cm:.0f} cm from where the hand carried it")


def test_a_detection_from_before_that_comes_only_after_the_release_is_no_rest() -> None:
    tape = Tape({"A": A, "box": BOX}).reach("A").hide("A").press("pick", "A").wait(0.15).grip("closed", "A").wait(0.3)
    tape.release("place", GOAL).put("A", A).show("A").wait(1.0)
    place = observe(tape.recording()).actions[1]
    assert not place.rest_seen
    assert math.dist((place.rest or {})[BASE].position, GOAL.position) < 1e-3


def test_what_is_put_back_where_it_was_picked_rests_there() -> None:
    place = observe(Tape({"A": A, "box": BOX}).pick("A").release("place", A).recording()).actions[1]
    assert place.rest_seen
    assert math.dist((place.rest or {})[BASE].position, A.position) < 1e-3


def test_a_detection_that_comes_back_after_the_release_is_the_rest() -> None:
    tape = left_behind().grip("open").wait(0.5).put("A", at(0.53, -0.22)).wait(0.8)
    place = observe(tape.recording()).actions[1]
    assert place.rest_seen
    assert math.dist((place.rest or {})[BASE].position, at(0.53, -0.22).position) < 1e-3


def test_an_object_that_slipped_in_the_hand_is_where_it_is_seen_and_doubtful() -> None:
    tape = Tape({"A": A, "box": BOX}).pick("A")
    tape.grasped["A"] = Pose((0.04, 0.0, 0.0)) @ tape.grasped["A"]
    pick, place = judged(tape.release("place", GOAL).recording())
    assert pick.verdict == "accepted"
    assert place.verdict == "doubtful"
    assert math.dist(place.objects["A"].position, GOAL.position) < 1e-3


# Contradictions, one after the other


def test_after_a_contradiction_the_next_press_is_judged_as_if_it_were_true() -> None:
    tape = Tape({"A": A, "box": BOX}).reach("A").grip("closed").wait(0.3).press("pick", "A").wait(0.5)
    pick, place = judged(tape.press("place", "A").wait(0.3).recording())
    assert (pick.verdict, pick.reason) == ("contradicts", "action 0 (pick) contradicts the gripper: it is not open")
    assert place.verdict == "accepted"


def test_the_words_of_a_contradiction_are_those_of_the_quarantine() -> None:
    recording = Tape({"A": A, "box": BOX}).pick("A").press("pick", "box").wait(0.3).recording()
    with pytest.raises(DemonstrationRefusedError) as refused:
        observe(recording)
    assert str(refused.value) == judged(recording)[1].reason
