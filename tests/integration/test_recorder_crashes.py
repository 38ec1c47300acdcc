"""kill -9, torn files and damaged ones: what was durable comes back, and nothing is guessed."""

from __future__ import annotations

import json
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh
from mcap.reader import make_reader
from mcap.writer import Writer
from support_killed_recorder import answers as _answers
from support_killed_recorder import live_and_die
from support_recorder import (
    CELL,
    PREFIX,
    START,
    ask,
    configuration,
    free_endpoint,
    network,
    recording_cell,
    wait_for,
)

from learner.model import Pose
from pipelines.cli import main
from recorder.daemon import Recorder
from recorder.errors import RecorderError, SecondRecorderError, TornRecordingError
from recorder.recording import Demonstrated, RecordingWriter, messages, read_header, read_recording
from recorder.recovery import recover, recover_folder
from recorder.wire import ACTION, POSES, pose_message

DEMONSTRATED = Demonstrated("stacking-1", "stacking", "u1", CELL, "base", "tool0", ("A",), outcome="success")
TOOL = {"tool0": Pose((0.5, 0.0, 0.3)), "A": Pose((0.5, 0.0, 0.02))}


def torn(file: Path, chunks: int = 5) -> Path:
    """An unfinished file of so many chunks, each with a pose and an action."""
    with RecordingWriter(file, DEMONSTRATED) as writer:
        for number in range(chunks):
            stamp_ns = (number + 1) * 1_000_000
            writer.write(POSES, pose_message(stamp_ns, "base", TOOL), stamp_ns)
            writer.write(ACTION, json.dumps({"stamp_ns": stamp_ns, "type": "pick"}).encode(), stamp_ns)
            writer.write("/image", bytes(range(256)) * 20, stamp_ns, encoding="image/raw")
            writer.close_chunk()
        return writer.unfinished


def test_every_durable_action_with_its_poses_survives_kill_9(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    lives = [live_and_die(tmp_path / str(life), rng) for life in range(20)]
    assert sum(life.durable for life in lives) > 20
    # 200 ms is the goal, measured by the benchmarks; a machine under load may stand still for longer than that.
    assert max(life.missing_s for life in lives) < 2.0, lives


def test_a_recorder_completes_at_its_start_what_was_torn(tmp_path: Path) -> None:
    original = torn(tmp_path / "stacking-1.mcap").read_bytes()
    with network() as (ours, theirs):
        events: list[dict[str, object]] = []
        with Recorder(ours, CELL, tmp_path, None, events.append):
            wait_for(lambda: _answers(theirs))
            (alarm,) = ask(theirs, "status")["alarms"]
    assert "stacking-1.mcap was torn and is completed with 15 messages" in alarm
    assert [(event["event"], event["fate"]) for event in events] == [("recovery", "recovered")]
    assert len(read_recording([tmp_path / "stacking-1.mcap"]).presses) == 5
    assert (tmp_path / "torn" / "stacking-1.mcap.part").read_bytes() == original
    assert not list(tmp_path.glob("*.part"))


def test_every_torn_end_keeps_every_whole_chunk(tmp_path: Path) -> None:
    whole = torn(tmp_path / "a.mcap").read_bytes()
    starts = [place for place in range(len(whole)) if whole.startswith(b"\x06", place) and _is_chunk(whole, place)]
    for cut in range(starts[0], len(whole), 97):
        part = tmp_path / "b.mcap.part"
        part.write_bytes(whole[:cut] + bytes(9000 * (cut % 2)))
        file = tmp_path / f"{cut}.mcap"
        recover(part, file)
        ends = [start + 9 + int.from_bytes(whole[start + 1 : start + 9], "little") for start in starts]
        assert len(read_recording([file]).presses) == sum(end <= cut for end in ends)
        with file.open("rb") as stream:
            summary = make_reader(stream, validate_crcs=True).get_summary()
            assert summary is not None


def _is_chunk(data: bytes, place: int) -> bool:
    return b"zstd" in data[place : place + 60]


def test_of_a_damaged_file_what_is_whole_is_kept_and_the_original_untouched(tmp_path: Path) -> None:
    damaged = bytearray(torn(tmp_path / "stacking-1.mcap").read_bytes())
    damaged[damaged.index(b"zstd") + 30] ^= 0x01
    part = tmp_path / "stacking-1.mcap.part"
    part.write_bytes(damaged)
    told: list[tuple[str, str]] = []
    recover_folder(tmp_path, lambda *fate: told.append(fate))
    ((fate, sentence),) = told
    assert fate == "recovered"
    assert "the chunk at byte" in sentence
    assert (tmp_path / "torn" / part.name).read_bytes() == damaged
    assert read_header(tmp_path / "stacking-1.mcap").demonstration_id


def test_what_does_not_tell_whose_it_is_is_quarantined_untouched(tmp_path: Path) -> None:
    part = tmp_path / "stacking-1.mcap.part"
    part.write_bytes(b"noise" * 100)
    assert recover_folder(tmp_path, lambda *_: None) == {"quarantined": 1}
    assert (tmp_path / "quarantine" / part.name).read_bytes() == b"noise" * 100
    assert not list(tmp_path.glob("*.mcap*"))


def test_a_file_that_only_lacks_its_name_gets_it(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "one.mcap", DEMONSTRATED) as writer:
        writer.finish()
    content = (tmp_path / "one.mcap").read_bytes()
    (tmp_path / "one.mcap").rename(tmp_path / "one.mcap.part")
    assert recover_folder(tmp_path, lambda *_: None) == {"renamed": 1}
    assert (tmp_path / "one.mcap").read_bytes() == content


def test_a_recovery_cut_off_anywhere_is_begun_anew(tmp_path: Path) -> None:
    part = torn(tmp_path / "one.mcap")
    (tmp_path / "one.mcap.recovering.part").write_bytes(b"half a copy")
    assert recover_folder(tmp_path, lambda *_: None) == {"recovered": 1}
    (tmp_path / "torn" / part.name).rename(part)
    before = (tmp_path / "one.mcap").read_bytes()
    assert recover_folder(tmp_path, lambda *_: None) == {"recovered": 1}
    assert (tmp_path / "one.mcap").read_bytes() == before


def test_a_file_that_is_being_recorded_is_not_recovered_by_another(tmp_path: Path) -> None:
    """A second recorder on another network shares the disk: the lock keeps it out."""
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        with network() as (ours, _), pytest.raises(SecondRecorderError), Recorder(ours, CELL, tmp_path):
            pass
        assert cell.ask("stop", {"outcome": "success"})["messages"] == {}


def test_the_torn_file_of_another_writer_keeps_its_schemas_and_other_records(tmp_path: Path) -> None:
    part = tmp_path / "other.mcap"
    with part.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("treewright.demonstration", DEMONSTRATED.to_metadata())
        writer.add_metadata("weather", {"sky": "grey"})
        schema = writer.register_schema("demo.Force", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/force", "json", schema, {"unit": "N"})
        for number in range(10):
            writer.add_message(channel, number, b"{}", number, number)
        writer.flush()
    with pytest.raises(TornRecordingError):
        read_header(part)
    recover(part, tmp_path / "whole.mcap")
    with (tmp_path / "whole.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert [m.name for m in reader.iter_metadata()].count("weather") == 1
        found = [(s.name, c.metadata["unit"], m.sequence) for s, c, m in reader.iter_messages() if s]
    assert found == [("demo.Force", "N", number) for number in range(10)]


def test_what_is_whole_or_there_already_is_not_recovered(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "one.mcap", DEMONSTRATED) as writer:
        writer.finish()
    with pytest.raises(RecorderError, match="is whole; there is nothing to recover"):
        recover(tmp_path / "one.mcap", tmp_path / "two.mcap")
    part = torn(tmp_path / "three.mcap")
    with pytest.raises(RecorderError, match="exists already"):
        recover(part, tmp_path / "one.mcap")


def test_the_command_recovers_by_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part = torn(tmp_path / "one.mcap")
    content = part.read_bytes()
    assert main(["recover", str(part), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["file"] == str(tmp_path / "one.mcap")
    assert report["messages"] == {ACTION: 5, "/image": 5, POSES: 5}
    assert part.read_bytes() == content
    assert [c.topic for c, _ in messages(tmp_path / "one.mcap")][:3] == [POSES, ACTION, "/image"]
    assert main(["recover", str(part)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert main(["recover", str(tmp_path / "nowhere.mcap")]) == 1
    assert "nowhere.mcap" in capsys.readouterr().err


def test_a_terminated_daemon_closes_its_recording_durably(tmp_path: Path) -> None:
    """The real command in a process of its own, ended as an operating system ends it."""
    import os
    import subprocess
    import sys

    endpoint = free_endpoint()
    process = subprocess.Popen(
        [sys.executable, "-m", "pipelines.cli", "record", "--cell", CELL, "--listen", endpoint, "--json"],
        env={**os.environ, "TREEWRIGHT_HOME": str(tmp_path)},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline()) == {"ready": True}
        with zenoh.open(configuration(connect=endpoint)) as session:
            wait_for(lambda: _answers(session))
            file = Path(ask(session, "start", START)["file"])
            session.put(f"{PREFIX}/force", b"1", congestion_control=zenoh.CongestionControl.BLOCK)
            wait_for(lambda: ask(session, "status")["messages"])
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
    finally:
        process.kill()
        process.wait()
    assert file.parent == tmp_path / "recordings" / CELL
    assert read_header(file) == replace(
        read_header(file), outcome="unknown", messages_lost={"/force": None}, task="stacking"
    )
    assert [message.data for _, message in messages(file)] == [b"1"]
