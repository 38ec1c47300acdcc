"""What the recorder remembers while a demonstration is made: names that the poses tell, states of the gripper."""

from __future__ import annotations

import pytest

from learner.model import Pose
from recorder.teaching.feedback import Sightings
from recorder.teaching.known import KNOWN_NS, Known
from recorder.wire import NS, gripper_message, pose_message

HERE = {"tool0": Pose((0.5, 0.0, 0.3)), "A": Pose((0.5, 0.0, 0.02))}
WANTED = {"A": "object", "tool0": "frame"}


def test_names_are_known_for_a_minute_after_they_were_told() -> None:
    known = Known()
    assert known.missing(WANTED, "base", 0) == "no poses are published in this cell"
    known.take(pose_message(1, "base", HERE), NS)
    assert known.missing(WANTED, "base", NS + KNOWN_NS) is None
    assert known.missing(WANTED, "base", NS + KNOWN_NS + 1) == "no poses are published in this cell"
    known.take(pose_message(2, "base", {"tool0": HERE["tool0"]}), NS + KNOWN_NS)
    assert str(known.missing(WANTED, "base", NS + KNOWN_NS + 1)).startswith(
        "the cell's poses do not tell of the object A;"
    )


def test_what_is_told_in_another_frame_is_named_with_it() -> None:
    known = Known()
    known.take(pose_message(1, "camera", HERE), 1)
    sentence = known.missing(WANTED, "base", 1)
    assert sentence == "the cell's poses do not tell of the object A, the frame tool0; they tell of A, tool0 in camera"


def test_what_is_no_pose_tells_no_name() -> None:
    known = Known()
    known.take(b"\xff\xff", 1)
    assert known.missing(WANTED, "base", 1) == "no poses are published in this cell"


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4, 5, 6, 7), (0, 2, 1, 3, 4, 6, 5, 7)])
def test_of_each_run_of_a_state_the_first_and_the_last_are_kept(order: tuple[int, ...]) -> None:
    sightings = Sightings("base")
    states = ["open"] * 4 + ["closed"] * 3 + ["open"]
    for number in order:
        sightings.add_gripper(gripper_message((1000 + number) * NS // 10, states[number]), number * NS // 10)
    kept = [(sample.stamp_ns * 10 // NS - 1000, sample.state) for sample in sightings.gripper]
    assert kept == sorted(kept)
    assert {(0, "open"), (3, "open"), (4, "closed"), (6, "closed"), (7, "open")} <= set(kept)


def test_the_present_is_that_of_the_clock_that_stamps_the_poses() -> None:
    sightings = Sightings("base", ("tool0",))
    assert sightings.now_ns("tool0", 5 * NS) == 5 * NS
    sightings.add(pose_message(1000 * NS, "base", HERE), 5 * NS)
    assert sightings.now_ns("tool0", 6 * NS) == 1001 * NS
    track = sightings.tracks(("tool0", "B"))["tool0"]
    assert (track.stamps_ns.tolist(), track.positions.tolist()) == ([1000 * NS], [[0.5, 0.0, 0.3]])
