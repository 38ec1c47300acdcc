"""Demonstrated actions as a table: the same poses as the actions have, and selections that are tables again."""

from __future__ import annotations

import numpy as np
import pytest
from support_demonstrations import BASE, ON_TOP, ORIGIN, Put, Take, scattered, scripted

from learner.errors import NothingLearnedError
from learner.inference.samples import Samples
from learner.inference.support import stayed
from learner.model import Demonstration, Pose

SCRIPT = [Put("A", "box", (0.0, 0.0, 0.02), "drop", fall_m=0.08), Put("B", "C", ON_TOP), Take("A")]


def shown(count: int = 4) -> list[Demonstration]:
    rng = np.random.default_rng(3)
    starts = [scattered(["A", "B", "C", "box"], rng) for _ in range(count)]
    return [
        scripted(start, SCRIPT, f"d{number}", user=f"u{number % 2}", rng=rng) for number, start in enumerate(starts)
    ]


@pytest.mark.parametrize("frame", [BASE, "box", "C"])
def test_every_row_has_the_poses_of_its_action(frame: str) -> None:
    demonstrations = shown()
    samples = Samples.of(demonstrations)
    actions = [action for demonstration in demonstrations for action in demonstration.actions]
    assert len(samples) == len(actions)
    for row, action in enumerate(actions):
        origin = ORIGIN if frame == BASE else action.objects[frame]
        assert samples.target(frame).pose(row) == origin.inverse() @ action.end_effector
        assert samples.release(frame).pose(row) == origin.inverse() @ action.objects[action.object]
        assert samples.candidate(frame)[row] == (frame == BASE or frame in action.frames)
        if action.rest and frame in action.rest:
            assert samples.rest(frame).pose(row) == action.rest[frame]


def test_a_fall_is_how_far_an_object_came_down_and_unknown_for_a_pick() -> None:
    samples = Samples.of(shown())
    fell = samples[samples.type == "drop"].fall_m
    assert np.allclose(fell, 0.08, atol=0.01)
    assert np.isnan(samples[samples.type == "pick"].fall_m).all()


def test_the_samples_of_some_demonstrations_are_those_of_a_table_of_them_alone() -> None:
    demonstrations = shown(5)
    some = Samples.of(demonstrations).of_demonstrations(np.array([True, False, True, False, True]))
    alone = Samples.of(demonstrations[::2])
    assert some.demonstrations == alone.demonstrations
    assert some.demonstration.tolist() == alone.demonstration.tolist()
    assert some.users.tolist() == alone.users.tolist()
    assert some.progress.tolist() == alone.progress.tolist()
    for frame in alone.frames:
        assert np.array_equal(some.rest(frame).positions, alone.rest(frame).positions, equal_nan=True)
        assert np.array_equal(some.ends(frame).positions, alone.ends(frame).positions, equal_nan=True)


def test_a_selection_of_a_selection_is_a_selection() -> None:
    samples = Samples.of(shown())
    picks = samples[samples.type == "pick"]
    assert (
        picks[picks.object == "B"].rows.tolist()
        == samples[(samples.type == "pick") & (samples.object == "B")].rows.tolist()
    )
    assert samples[1:1].frames == [BASE]


def test_what_was_not_seen_is_unknown() -> None:
    samples = Samples.of(shown())
    assert not samples.origin("nobody saw this").known.any()
    assert not samples.ends("nobody saw this").known.any()
    assert samples.ends(BASE).pose(0) == Pose((0.0, 0.0, 0.0))


def test_demonstrations_in_two_base_frames_are_refused() -> None:
    from dataclasses import replace

    first, second, *_ = shown()
    with pytest.raises(NothingLearnedError, match="differ in their base frame: base, world"):
        Samples.of([first, replace(second, base_frame="world")])


def test_whether_an_object_stayed_does_not_depend_on_which_others_are_looked_at() -> None:
    box, tray = (Put("A", name, (0.0, 0.0, 0.02), "drop", fall_m=0.08) for name in ("box", "C"))
    starts = [scattered(["A", "C", "box"], np.random.default_rng(3 + number)) for number in range(4)]
    scripts = [[box], [box, tray], [box, Put("box", BASE, (0.5, 0.0, 0.0))], [tray, box]]
    demonstrations = [
        scripted(start, script, f"d{number}")
        for number, (start, script) in enumerate(zip(starts, scripts, strict=True))
    ]
    samples = Samples.of(demonstrations)
    releases = samples[(samples.object == "A") & (samples.type == "drop")]
    everywhere = stayed("box", releases, 0.04).tolist()
    assert everywhere == [True, True, True, False, True, True]  # where the box is carried away, A stays behind
    for row in range(len(releases)):
        assert stayed("box", releases[row : row + 1], 0.04).tolist() == everywhere[row : row + 1]
