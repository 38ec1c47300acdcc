"""What is odd about a cell's messages is told while recording and at ingest, each for what it is."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zenoh
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from support_recorder import PREFIX, START, Cell, recording_cell, wait_for

from learner.errors import DemonstrationRefusedError
from learner.model import Pose
from learner.observation import observe
from recorder.errors import RecorderError
from recorder.recording import read_recording
from recorder.wire import NS, action_message, gripper_message, pose_message

NAMES = ("A", "B", "tool0")
POSES = {"A": Pose((0.3, 0.0, 0.1)), "B": Pose((0.0, 0.3, 0.1)), "tool0": Pose((0.3, 0.0, 0.1))}
HOUR = 3600 * NS


def whole(stamp_ns: int) -> FrameTransforms:
    return FrameTransforms.FromString(pose_message(stamp_ns, "base", POSES))


def usual(stamp_ns: int) -> bytes:
    return whole(stamp_ns).SerializeToString()


def changed(**fields: object) -> Callable[[int], bytes]:
    """Messages of /poses in which every transform has other fields."""

    def message(stamp_ns: int) -> bytes:
        found = whole(stamp_ns)
        for transform in found.transforms:
            for name, value in fields.items():
                if isinstance(value, str):
                    setattr(transform, name, value)
                else:
                    getattr(transform, name).CopyFrom(type(getattr(transform, name))(**value))  # type: ignore[arg-type]
        return found.SerializeToString()

    return message


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> object:
    with recording_cell(tmp_path_factory.mktemp("odd")) as cell:
        yield cell


def gripper(cell: Cell, state: str = "open") -> None:
    cell.put_json("gripper", {"stamp_ns": time.time_ns(), "state": state})


def demonstrate(
    cell: Cell, poses: Callable[[int], bytes], grip: Callable[[Cell], None] = gripper
) -> tuple[list[str], str]:
    """The alarms of a demonstration of one pick, and why it was refused at ingest; nothing if it was not."""
    cell.ask("start", START)
    grip(cell)
    for _ in range(5):
        cell._poses.put(poses(time.time_ns()))
        time.sleep(0.02)
    cell.ask("status")
    cell.press("pick", object="A")
    cell.ask("status")
    stopped = cell.ask("stop", {"outcome": "unknown"})
    try:
        observe(read_recording([Path(stopped["file"])]))
    except (DemonstrationRefusedError, RecorderError) as error:
        return cell.ask("status")["alarms"], str(error)
    return cell.ask("status")["alarms"], ""


@pytest.mark.parametrize(
    ("poses", "alarm", "reason"),
    [
        (lambda ns: b'{"transforms": []}', "is JSON", "is JSON"),
        (changed(rotation={"w": 0.0}), "a quaternion of zeros", "a quaternion of zeros"),
        (changed(timestamp={"seconds": 0}), "no timestamp", "no timestamp"),
        (changed(parent_frame_id="world"), "given in 'world', not in the base frame base", "relative to world"),
        (changed(translation={"x": 412.0}), "look like millimetres", "look like millimetres"),
    ],
)  # fmt: skip
def test_poses_of_another_kind_are_told_for_what_they_are(
    cell: Cell, poses: Callable[[int], bytes], alarm: str, reason: str
) -> None:
    alarms, refusal = demonstrate(cell, poses)
    assert any(alarm in sentence for sentence in alarms)
    assert reason in refusal


def test_nothing_on_poses_is_told(cell: Cell) -> None:
    cell.ask("start", START)
    wait_for(lambda: any("nothing is published on /poses" in each for each in cell.ask("status")["alarms"]))
    assert any("nothing is published on /gripper" in each for each in cell.ask("status")["alarms"])
    cell.press("pick")
    stopped = cell.ask("stop", {"outcome": "unknown"})
    with pytest.raises(DemonstrationRefusedError, match="holds no poses"):
        observe(read_recording([Path(stopped["file"])]))


@pytest.mark.parametrize("payload", ["half", {"stamp_ns": 1.5}, {"stamp_ns": 1, "state": "ajar"}])
def test_a_malformed_gripper_is_told(cell: Cell, payload: object) -> None:
    alarms, refusal = demonstrate(
        cell, lambda ns: whole(ns).SerializeToString(), lambda c: c.put_json("gripper", payload)
    )
    assert any("a message on /gripper has" in sentence for sentence in alarms)
    assert "a message on /gripper has" in refusal


def test_one_malformed_message_among_others_stops_nothing(cell: Cell) -> None:
    def grip(cell: Cell) -> None:
        gripper(cell)
        cell.put_json("gripper", "half")

    def poses(stamp_ns: int) -> bytes:
        return b"\xff\xff" if stamp_ns % 2 else whole(stamp_ns).SerializeToString()

    stamps = iter([0, 1, 0, 0, 0])
    alarms, refusal = demonstrate(cell, lambda ns: poses(ns // 2 * 2 + next(stamps)), grip)
    assert refusal == ""
    assert any("/gripper has no stamp_ns" in sentence for sentence in alarms)
    assert any("/poses is b'" in sentence for sentence in alarms)


def test_single_transforms_are_accepted_and_written_as_the_contract_has_them(cell: Cell) -> None:
    cell.ask("start", START)
    gripper(cell)
    stamp_ns = time.time_ns()
    for transform in whole(stamp_ns).transforms:
        cell._poses.put(transform.SerializeToString())
    cell.ask("status")
    cell.press("pick", object="A")
    cell.ask("status")
    stopped = cell.ask("stop", {"outcome": "unknown"})
    assert not cell.ask("status")["alarms"]
    assert observe(read_recording([Path(stopped["file"])])).actions[0].object == "A"


@pytest.mark.parametrize("off_ns", [-HOUR, 10_000 * HOUR])
def test_a_demonstration_is_not_blinded_by_the_stamps_of_the_one_before(cell: Cell, off_ns: int) -> None:
    def elsewhen(stamp_ns: int) -> bytes:
        return whole(stamp_ns + off_ns).SerializeToString()

    demonstrate(cell, elsewhen)
    alarms, refusal = demonstrate(cell, usual)
    assert (alarms, refusal) == ([], "")


@pytest.mark.parametrize(("off_ns", "way"), [(-HOUR, "back"), (HOUR, "ahead")])
def test_a_clock_that_is_set_while_recording_is_told_and_the_account_goes_on(cell: Cell, off_ns: int, way: str) -> None:
    cell.ask("start", START)
    for number in range(40):
        moved_ns = off_ns if number >= 10 else 0
        now_ns = time.time_ns() + moved_ns
        cell._poses.put(whole(now_ns).SerializeToString())
        if number % 10 == 0:
            cell.put_json("gripper", {"stamp_ns": now_ns, "state": "open"})
        time.sleep(0.02)
    pressed_ns = cell.press("pick", time.time_ns() + off_ns, object="A")
    event = cell.await_event("action", recorded=True, action_stamp_ns=pressed_ns)
    assert event["findings"] == []
    stopped = cell.ask("stop", {"outcome": "unknown"})
    assert any(f"was set {way} by 3600" in note for note in stopped["notes"])
    demonstration = observe(read_recording([Path(stopped["file"])]))
    assert demonstration.actions[0].object == "A"
    assert any(f"was set {way}" in warning for warning in demonstration.warnings)


def odd_payloads(count: int) -> list[bytes]:
    """Valid messages of every kind, each mutated in a few bytes, and some that are nothing at all."""
    rng = np.random.default_rng(7)
    stamp_ns = time.time_ns()
    right = [
        usual(stamp_ns),
        gripper_message(stamp_ns, "open", 0.08),
        action_message(stamp_ns, "pick", object="A"),
    ]
    odd = [b"", b"\xff" * 9, b"[" * 50_000, b'{"stamp_ns": 1, "type": "\\ud800"}', b'{"stamp_ns": 1e400}', b"9" * 5000]
    for number in range(count):
        payload = bytearray(right[number % 3])
        for index in rng.integers(0, len(payload), 3):
            payload[index] = rng.integers(256)
        odd.append(bytes(payload))
    return odd


def test_whatever_is_published_is_recorded_and_the_rest_goes_on(cell: Cell) -> None:
    odd = odd_payloads(200)
    keys = ["poses", "gripper", "action", "signals/door", "x" * 3000, "ünï/cödé/…", "a b/%00?", "recorder"]
    cell.ask("start", START)
    for number, payload in enumerate(odd):
        for key in (*keys[:3], keys[3 + number % 5]):
            cell.session.put(
                f"{PREFIX}/{key}".replace("?", ""), payload, congestion_control=zenoh.CongestionControl.BLOCK
            )
    stopped = cell.ask("stop", {"outcome": "unknown"})
    assert [stopped["messages"][f"/{key}"] for key in keys[:3]] == [len(odd)] * 3
    assert not any("defect" in told.get("alarm", "") for told in cell.events)
    with contextlib.suppress(DemonstrationRefusedError, RecorderError):
        observe(read_recording([Path(stopped["file"])]))
    assert demonstrate(cell, usual) == ([], "")
