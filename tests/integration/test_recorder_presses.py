"""Presses are judged when they come, by the rules of ingest; what contradicts keeps a demonstration from success."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support_recorder import PREFIX, START, Cell, Refused, recording_cell, wait_for

from learner.errors import DemonstrationRefusedError
from learner.model import Pose
from learner.observation import observe
from recorder.recording import read_recording

SEEN = {key: value for key, value in START.items() if key != "unseen_ok"}
AT_A, AT_B, AWAY = (0.5, 0.0, 0.02), (0.4, 0.1, 0.02), (0.5, 0.3, 0.3)


class Bench:
    """A cell that publishes its poses all the time, and its gripper's state."""

    def __init__(self, cell: Cell) -> None:
        self.cell, self.poses, self._ended = cell, {"A": AT_A, "B": AT_B, "tool0": AWAY}, threading.Event()
        self._thread = threading.Thread(target=self._publish)
        self._thread.start()

    def _publish(self) -> None:
        while not self._ended.wait(0.01):
            self.cell.put_poses({name: Pose(position) for name, position in self.poses.items()})

    def close(self) -> None:
        self._ended.set()
        self._thread.join()

    def grip(self, state: str) -> None:
        self.cell.put_json("gripper", {"stamp_ns": time.time_ns(), "state": state})

    def start(self, hand: tuple[float, float, float] = AT_A) -> None:
        """A demonstration begins with an open gripper and the hand at a place."""
        self.poses["tool0"] = hand
        self.cell.ask("start", SEEN)
        self.grip("open")
        wait_for(lambda: self.cell.ask("status")["messages"].get("/poses", 0) > 8)

    def press(self, kind: str, **more: Any) -> tuple[int, str, str | None, str, str | None]:
        reply = self.cell.ask("press", {"type": kind, **more})
        return reply["step"], reply["type"], reply["object"], reply["verdict"], reply["reason"]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with (
        recording_cell(tmp_path_factory.mktemp("presses")) as cell,
        contextlib.closing(Bench(cell)) as bench,
    ):
        yield bench


@pytest.fixture(autouse=True)
def idle(bench: Bench) -> Iterator[None]:
    yield
    if bench.cell.ask("status")["state"] != "idle":
        bench.cell.ask("discard")
    bench.poses.update({"A": AT_A, "B": AT_B, "tool0": AWAY})
    bench.cell.events.clear()


def test_presses_that_fit_are_accepted_and_learned_from(bench: Bench) -> None:
    bench.start()
    assert bench.press("pick") == (0, "pick", "A", "accepted", None)
    bench.grip("closed")
    bench.poses |= {"A": AWAY, "tool0": AWAY}
    time.sleep(0.4)
    assert bench.press("place", object="A") == (1, "place", "A", "accepted", None)
    bench.grip("open")
    time.sleep(0.5)
    stopped = bench.cell.ask("stop", {"outcome": "success"})
    assert (stopped["messages"]["/action"], stopped["lost"]["/action"]) == (2, 0)
    found = observe(read_recording([Path(stopped["file"])]))
    assert [(action.type, action.object, action.warnings) for action in found.actions] == [
        ("pick", "A", ()),
        ("place", "A", ()),
    ]


def test_the_stamp_of_a_press_is_of_the_clock_that_stamps_the_poses(bench: Bench) -> None:
    bench.start()
    before_ns = time.time_ns()
    reply = bench.cell.ask("press", {"type": "pick"})
    assert before_ns - 5e8 < reply["stamp_ns"] < time.time_ns()
    stopped = bench.cell.ask("stop", {"outcome": "unknown"})
    (press,) = read_recording([Path(stopped["file"])]).presses
    assert press.stamp_ns == reply["stamp_ns"]


def test_nothing_near_is_told_at_once_and_no_success(bench: Bench) -> None:
    """The report: an open gripper, nothing near, and pick, place and success were answered without a word."""
    bench.start(hand=AWAY)
    step, _, name, verdict, reason = bench.press("pick", object="A")
    assert (step, name, verdict) == (0, "A", "doubtful")
    assert "InGripper of A could never hold" in str(reason)
    assert bench.press("place")[3:] == ("contradicts", "action 1 (place) contradicts the gripper: it is not closed")
    with pytest.raises(Refused, match=r"cannot stop with outcome success: action 1 \(place\) contradicts the gripper"):
        bench.cell.ask("stop", {"outcome": "success"})
    assert bench.cell.ask("status")["state"] == "recording"
    stopped = bench.cell.ask("stop", {"outcome": "failure"})
    assert stopped["messages"]["/action"] == 2, "what contradicts is recorded all the same"
    with pytest.raises(DemonstrationRefusedError, match=r"action 1 \(place\) contradicts the gripper"):
        observe(read_recording([Path(stopped["file"])]))


def test_what_is_taken_back_does_not_stand_in_the_way(bench: Bench) -> None:
    bench.start()
    assert bench.press("undo")[3:] == ("doubtful", "there is no action that could be taken back")
    assert bench.press("pick", object="A")[3] == "accepted"
    assert bench.press("pick", object="B")[3:] == ("contradicts", "action 1 picks while A is held")
    assert bench.press("undo") == (1, "undo", "B", "accepted", None)
    bench.grip("closed")
    stopped = bench.cell.ask("stop", {"outcome": "success"})
    assert [action.object for action in observe(read_recording([Path(stopped["file"])])).actions] == ["A"]


def test_a_gripper_that_never_closed_is_no_success(bench: Bench) -> None:
    bench.start()
    bench.press("pick", object="A")
    for after_ns in (1_000_000_000, 2_500_000_000):
        bench.cell.put_json("gripper", {"stamp_ns": time.time_ns() + after_ns, "state": "open"})
    bench.cell.ask("status")
    with pytest.raises(Refused, match="it never became closed"):
        bench.cell.ask("stop", {"outcome": "success"})


def test_a_signal_is_recorded_and_told_as_not_planned_with(bench: Bench) -> None:
    bench.start()
    step, kind, name, verdict, reason = bench.press("signal", signal="door", value=True)
    assert (step, kind, name, verdict) == (0, "signal", None, "doubtful")
    assert "sets door to true" in str(reason)


def test_a_press_on_the_topic_gets_the_same_document_as_an_event(bench: Bench) -> None:
    bench.start()
    reply = bench.cell.ask("press", {"type": "pick", "object": "A"})
    assert reply.items() <= bench.cell.await_event("action").items()
    bench.cell.events.clear()
    stamp_ns = bench.cell.press("pick", object="B")
    told = bench.cell.await_event("action")
    names = ("step", "type", "object", "stamp_ns", "verdict", "reason")
    expected = (1, "pick", "B", stamp_ns, "contradicts", "action 1 picks while A is held")
    assert tuple(told[name] for name in names) == expected


@pytest.mark.parametrize(
    ("request_", "sentence"),
    [
        ({}, "a press is of type pick, place, drop, signal, undo, not 'None'"),
        ({"type": "push"}, "not 'push'"),
        ({"type": ["pick"]}, "a press is of type"),
        ({"type": "pick", "object": "../A"}, "object name '../A' is refused"),
        ({"type": "pick", "object": 3}, "object name '3' is refused"),
        ({"type": "pick", "signal": "door"}, "a press of type pick has no signal"),
        ({"type": "undo", "object": "A"}, "a press of type undo has no object"),
        ({"type": "signal", "signal": "door"}, "needs signal and value"),
        ({"type": "signal", "signal": "door", "value": [1]}, "a truth, number or text"),
        ({"type": "signal", "signal": "door", "value": float("nan")}, "sets a signal to nan, which is no number"),
        ({"type": "pick", "stamp_ns": 2**70}, "stamp_ns in whole nanoseconds"),
        ({"type": "pick", "stamp_ns": "now"}, "stamp_ns in whole nanoseconds"),
    ],
)
def test_a_press_that_is_none_is_refused_and_not_recorded(bench: Bench, request_: object, sentence: str) -> None:
    bench.start()
    with pytest.raises(Refused, match=sentence):
        bench.cell.ask("press", request_)
    assert "/action" not in bench.cell.ask("status")["messages"]


def test_a_press_while_nothing_is_recorded_is_refused(bench: Bench) -> None:
    with pytest.raises(Refused, match="cannot press: nothing is being recorded"):
        bench.cell.ask("press", {"type": "pick"})
    bench.start()
    bench.cell.ask("pause")
    with pytest.raises(Refused, match=r"cannot press: .* is paused"):
        bench.cell.ask("press", {"type": "pick"})


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"objects": ["A", "C"]}, "do not tell of the object C; they tell of A, B, tool0 in base"),
        ({"end_effector_frame": "flange"}, "do not tell of the frame flange"),
        ({"base_frame": "world"}, "do not tell of the object A, the object B, the frame tool0; they tell of"),
        ({"scene": {"objects": {"D": {"size_m": [1, 1, 1]}}}}, "do not tell of the object of the scene D"),
    ],
)
def test_names_that_nobody_publishes_are_refused_unless_that_is_right(
    bench: Bench, changed: dict[str, object], sentence: str
) -> None:
    with pytest.raises(Refused, match=sentence):
        bench.cell.ask("start", {**SEEN, **changed})
    assert bench.cell.ask("start", {**SEEN, **changed, "unseen_ok": True})["demonstration_id"]


def test_a_cell_without_poses_cannot_start(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        with pytest.raises(Refused, match="no poses are published in this cell"):
            cell.ask("start", SEEN)
        with pytest.raises(Refused, match="`unseen_ok` of the request start is true or false"):
            cell.ask("start", {**SEEN, "unseen_ok": 1})


def test_an_action_of_another_type_is_told_and_can_be_taken_back(bench: Bench) -> None:
    bench.start()
    bench.cell.session.put(f"{PREFIX}/action", json.dumps({"stamp_ns": time.time_ns(), "type": "push"}))
    assert bench.cell.await_event("action")["verdict"] == "contradicts"
    assert bench.press("undo")[:2] == (0, "undo")
    assert bench.press("pick")[3] == "accepted"


def test_a_message_that_is_no_action_is_no_success_as_ingest_refuses_it(bench: Bench) -> None:
    bench.start()
    bench.cell.session.put(f"{PREFIX}/action", b"{half")
    bench.cell.await_event("alarm")
    with pytest.raises(Refused, match="success: a message on /action is not JSON"):
        bench.cell.ask("stop", {"outcome": "success"})
