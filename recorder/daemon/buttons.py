"""The operator's buttons: actions that are pressed, at the recorder or on the cell's network, judged and told of."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

from learner.model import ActionPress
from recorder import wire
from recorder.daemon.machine import LOOK_S, Machine
from recorder.daemon.requests import parse_press
from recorder.daemon.take import Take
from recorder.daemon.voice import Voice
from recorder.errors import PayloadError, RequestRefusedError
from recorder.intake.receiving import Arrival, Receiver
from recorder.teaching.presses import Pressed
from recorder.teaching.watch import Watch

SETTLE_S: Final = 0.4
"""Poses that arrive later than the press get so long before the operator is told that one is missing."""
ANSWER_S: Final = 0.2
"""A press that is not accepted is answered after so long [s], in case that what it needs is on its way."""


class Buttons:
    """Judges presses, on the thread of the requests. `submit` has something done there."""

    def __init__(
        self,
        machine: Machine,
        receiver: Receiver,
        watch: Watch,
        voice: Voice,
        submit: Callable[[Callable[[], None]], None],
    ) -> None:
        self._machine, self._receiver, self._watch = machine, receiver, watch
        self._voice, self._submit = voice, submit

    def press(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Record an action that is pressed here, and judge it at once. Raises RequestRefusedError."""
        take = self._machine.needs("press", self._machine.state == "recording")
        press = parse_press(request, self._present_ns(take))
        pressed, end_s = self._judged(take, press, self._record(press)), time.monotonic() + ANSWER_S
        while pressed.verdict != "accepted" and time.monotonic() < end_s:
            time.sleep(LOOK_S)
            self._judge_again(take, pressed)
        self._report_in_time(take, pressed)
        return pressed.to_data()

    def hear(self, arrival: Arrival) -> None:
        """An action has arrived from the cell's network."""
        try:
            press = wire.parse_action(arrival.payload)
        except PayloadError as error:
            self._hear_none(arrival, error)
            return
        take = self._machine.take
        if not arrival.recorded or take is None:
            self._voice.alarm(f"the action {press.type} is not recorded: {self._machine.situation}")
            self._voice.tell("action", type=press.type, recorded=False)
            return
        self._report_in_time(take, self._judged(take, press, arrival.log_ns))

    def _hear_none(self, arrival: Arrival, error: PayloadError) -> None:
        self._voice.alarm(f"an action that is none was published: {arrival.payload[:80]!r} {error}")
        if arrival.recorded and self._machine.take is not None:
            self._machine.take.presses.take_none(str(error))

    def _record(self, press: ActionPress) -> int:
        """Record a press; its log time [ns]."""
        fields = {"object": press.object, "signal": press.signal, "value": press.value}
        log_ns = self._receiver.record_press(wire.action_message(press.stamp_ns, press.type, **fields))
        if log_ns is None:
            raise RequestRefusedError(f"the action {press.type} cannot be recorded: memory or disk is full")
        return log_ns

    def _present_ns(self, take: Take) -> int:
        """The present [ns] by the clock that stamps the hand's poses, to which presses are matched."""
        with self._watch.sightings() as sightings:
            return sightings.now_ns(take.demonstrated.end_effector_frame, self._receiver.clock.now_ns())

    def _judged(self, take: Take, press: ActionPress, arrived_ns: int) -> Pressed:
        take.stamps.append((press.stamp_ns, press.type))
        with self._watch.sightings() as sightings:
            moved_ns = sightings.moved(press.stamp_ns, arrived_ns)
            return take.presses.take(replace(press, stamp_ns=moved_ns), press.stamp_ns, sightings)

    def _judge_again(self, take: Take, pressed: Pressed) -> None:
        with self._watch.sightings() as sightings:
            take.presses.again(pressed, sightings)

    def _report_in_time(self, take: Take, pressed: Pressed) -> None:
        """What a press needs may be on its way: one that is not accepted is judged once more before it is told."""
        if pressed.verdict == "accepted":
            self._report(take, pressed)
            return

        def again() -> None:
            if take is self._machine.take:
                self._judge_again(take, pressed)
                self._report(take, pressed)

        timer = threading.Timer(SETTLE_S, lambda: self._submit(again))
        timer.daemon = True
        timer.start()

    def _report(self, take: Take, pressed: Pressed) -> None:
        """Tell of a press."""
        take.unseen = pressed.finding.unseen
        findings = list(pressed.finding.sentences)
        more = {"action_stamp_ns": pressed.stamp_ns, "recorded": True, "unseen": list(take.unseen)}
        self._voice.tell("action", **pressed.to_data(), **more, findings=findings)
        for sentence in dict.fromkeys((*pressed.sentences, *findings)):
            self._voice.alarm(f"at the action {pressed.press.type}: {sentence}")
