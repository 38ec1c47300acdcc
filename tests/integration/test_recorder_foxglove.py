"""What a recording shows in Foxglove, read by decoders that are not ours, from the schemas in the file alone."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from support_recorder import START, network, recording_cell, wait_for

from learner.model import Pose
from recorder.recording import read_recording
from recorder.replay import Replay, replay

SCENE = {
    "objects": {
        "A": {"size_m": [0.05, 0.05, 0.05], "symmetry": "cube"},
        "B": {"size_m": [0.3, 0.2, 0.08], "symmetry": "box"},
    },
    "workspace_m": [[0.3, 0.7], [-0.4, 0.2]],
}
POSES = {"A": Pose((0.5, 0.0, 0.025)), "B": Pose((0.4, 0.2, 0.04)), "tool0": Pose((0.5, 0.0, 0.025))}
LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove-layout.json"
INFO, WARNING, ERROR = 2, 3, 4


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The two parts of a demonstration with a good press, one that contradicts it, and its undo."""
    with recording_cell(tmp_path_factory.mktemp("recordings")) as cell:
        cell.put_poses(POSES)
        cell.put_json("gripper", {"stamp_ns": time.time_ns(), "state": "open"})
        cell.ask("start", {**START, "scene": SCENE})
        cell.put_poses(POSES)
        cell.ask("press", {"type": "pick", "object": "A"})
        cell.ask("press", {"type": "pick", "object": "A"})
        cell.ask("press", {"type": "undo"})
        wait_for(lambda: len([event for event in cell.events if event["event"] == "action"]) == 3)
        cell.ask("split")
        stopped = cell.ask("stop", {"outcome": "success"})
        assert stopped["messages"] == {}
        assert stopped["lost"] == {}
        assert stopped["gaps"] == []
        return [Path(file) for file in stopped["parts"]]


def decoded(file: Path, topic: str) -> Iterator[Any]:
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message, content in reader.iter_decoded_messages(topics=[topic]):
            assert schema is not None
            assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf")
            assert channel.metadata["zenoh_encoding"] == f"application/protobuf;{schema.name}"
            yield schema.name, message.log_time, content


def test_every_part_shows_the_scene_as_boxes_in_the_frames_of_its_objects(recorded: list[Path]) -> None:
    for part in recorded:
        ((schema, log_ns, update),) = decoded(part, "/recorder/scene")
        assert schema == "foxglove.SceneUpdate"
        entities = {entity.id: entity for entity in update.entities}
        assert {name: entity.frame_id for name, entity in entities.items()} == {
            "A": "A", "B": "B", "the workspace": "base"
        }  # fmt: skip
        assert all(entity.frame_locked and entity.lifetime.ToNanoseconds() == 0 for entity in update.entities)
        assert {entity.timestamp.ToNanoseconds() for entity in update.entities} == {log_ns}
        (box,) = entities["B"].cubes
        assert (box.size.x, box.size.y, box.size.z) == (0.3, 0.2, 0.08)
        assert (box.pose.position.x, box.pose.orientation.w) == (0.0, 1.0)
        (floor,) = entities["the workspace"].cubes
        assert (floor.pose.position.x, floor.pose.position.y) == pytest.approx((0.5, -0.1))
        assert (floor.size.x, floor.size.y) == pytest.approx((0.4, 0.6))
        assert [text.text for text in entities["A"].texts] == ["A"]


def test_presses_and_alarms_are_log_lines_as_loud_as_they_are_bad(recorded: list[Path]) -> None:
    lines = [(line.level, line.name, line.message) for _, _, line in decoded(recorded[0], "/recorder/log")]
    presses = [(level, text) for level, name, text in lines if name == "press"]
    assert len(presses) == 3
    assert any(level == ERROR and ": contradicts: " in text for level, text in presses)
    assert all(": " in text and text.startswith("step ") for _, text in presses)
    alarms = [(level, text) for level, name, text in lines if name == "alarm"]
    assert alarms
    assert {level for level, _ in alarms} == {WARNING}


def test_a_press_that_nothing_speaks_against_is_no_warning(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        cell.put_poses(POSES)
        cell.put_json("gripper", {"stamp_ns": time.time_ns(), "state": "open"})
        cell.ask("start", START)
        cell.put_poses(POSES)
        cell.put_json("gripper", {"stamp_ns": time.time_ns(), "state": "open"})
        assert cell.ask("press", {"type": "pick", "object": "A"})["verdict"] == "accepted"
        file = Path(cell.ask("stop", {"outcome": "failure"})["file"])
    ((schema, _, line),) = decoded(file, "/recorder/log")
    assert (schema, line.level, line.message) == ("foxglove.Log", INFO, "step 0, pick A: accepted")
    assert list(decoded(file, "/recorder/scene")) == []


def test_what_is_shown_is_nothing_of_the_demonstration(recorded: list[Path]) -> None:
    recording = read_recording(recorded)
    assert [press.type for press in recording.presses] == ["pick", "pick", "undo"]
    assert recording.tracks.keys() == POSES.keys()


def test_a_replay_leaves_out_what_the_recorder_shows(recorded: list[Path]) -> None:
    with network() as (ours, _):
        (sent,) = replay(ours, "cell2", recorded, Replay(rate=100.0), threading.Event(), lambda sentence: None)
    assert set(sent) == {"/poses", "/gripper", "/action"}


def test_the_layout_shows_topics_that_a_recording_has(recorded: list[Path]) -> None:
    layout = json.loads(LAYOUT.read_text())
    panels = layout["configById"]
    placed = {word for word in _words(layout["layout"]) if "!" in word}
    assert placed == set(panels)
    with recorded[0].open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    named = {word.partition(".")[0] for word in _words(panels) if word.startswith("/")}
    assert named == {"/recorder/scene", "/recorder/log", "/poses", "/action", "/gripper"}
    assert named <= topics


def _words(data: Any) -> Iterator[str]:
    if isinstance(data, dict):
        yield from data
        data = list(data.values())
    if isinstance(data, list):
        for each in data:
            yield from _words(each)
    elif isinstance(data, str):
        yield data
