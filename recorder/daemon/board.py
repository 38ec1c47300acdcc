"""What the recorder writes into a recording for those who look at it in Foxglove, at the moment when it is so."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from recorder.foxglove import BOXES, LINES, SHOWN_ENCODINGS, alarm_message, boxes_message, press_message
from recorder.intake.receiving import Receiver
from recorder.recording import Demonstrated, parse_scene


def show_scene(receiver: Receiver, demonstrated: Demonstrated) -> None:
    """Each part of a recording tells the shapes at its beginning, where they are known."""
    if demonstrated.scene:
        scene = parse_scene(demonstrated.scene)
        _show(receiver, BOXES, lambda log_ns: boxes_message(log_ns, demonstrated.base_frame, scene))


def show_event(receiver: Receiver, told: Mapping[str, Any]) -> None:
    """Of the events of the recorder (CONTRACT, section 1): presses that are recorded, and alarms."""
    if told["event"] == "action" and told["recorded"]:
        _show(receiver, LINES, lambda log_ns: press_message(log_ns, told))
    elif told["event"] == "alarm":
        _show(receiver, LINES, lambda log_ns: alarm_message(log_ns, told["alarm"]))


def _show(receiver: Receiver, topic: str, payload_at: Callable[[int], bytes]) -> None:
    receiver.show(topic, SHOWN_ENCODINGS[topic], payload_at)
