"""Replay: what is published again is what was recorded, with its timing."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
from mcap.records import Channel
from support_recorder import CELL, PREFIX, START, network, recording_cell, wait_for

from learner.learning import learn
from learner.model import Pose, Recording
from learner.observation import observe
from pipelines.cli import main
from recorder.errors import RecorderError
from recorder.recording import Demonstrated, RecordingWriter, messages, read_header, read_recording
from recorder.replay import CACHE_BYTES, Replay, Timed, cached_samples, replay
from recorder.wire import ACTION, POSES, pose_message

SAMPLES = Path("../shared/data/contract_samples")
NS = 1_000_000_000


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Two seconds: poses, an action and bytes of no known kind, twenty a second."""
    demonstrated = Demonstrated("d-1", "t", "u", "elsewhere", "base", "tool0", ("A",), outcome="success")
    with RecordingWriter(tmp_path / "d-1.mcap", demonstrated) as writer:
        for number in range(40):
            stamp_ns = 1_000 * NS + number * NS // 20
            writer.write(POSES, pose_message(stamp_ns, "base", {"A": Pose((number, 0, 0))}), stamp_ns)
            writer.write("/sound", bytes([number, 255]), stamp_ns, encoding="audio/raw;8bit")
        writer.write(ACTION, json.dumps({"stamp_ns": 1_001 * NS, "type": "pick"}).encode(), 1_001 * NS)
        writer.finish()
    return tmp_path / "d-1.mcap"


def play(session: Any, file: Path, how: Replay, said: list[str] | None = None) -> list[dict[str, int]]:
    return list(replay(session, CELL, [file], how, threading.Event(), ([] if said is None else said).append))


def test_a_replay_recorded_again_is_the_same_byte_for_byte(tmp_path: Path, file: Path) -> None:
    with recording_cell(tmp_path / "again") as cell:
        cell.ask("start", START)
        (sent,) = play(cell.session, file, Replay(rate=20.0))
        again = Path(cell.ask("stop", {"outcome": "unknown"})["file"])

    def content(recording: Path) -> list[tuple[str, str, bytes]]:
        return sorted((c.topic, c.metadata["zenoh_encoding"], m.data) for c, m in messages(recording))

    assert content(again) == content(file)
    assert sent == {ACTION: 1, POSES: 40, "/sound": 40}
    assert read_header(again).messages_lost == {ACTION: 0, POSES: 0, "/sound": 0}


def test_a_replay_keeps_the_timing_at_its_rate(file: Path) -> None:
    with network() as (ours, theirs):
        arrived: list[float] = []
        with ours.declare_subscriber(f"{PREFIX}/sound", lambda _: arrived.append(time.monotonic())):
            time.sleep(0.2)
            play(theirs, file, Replay(rate=4.0))
            wait_for(lambda: len(arrived) == 40)
    assert arrived[-1] - arrived[0] == pytest.approx(39 / 20 / 4, rel=0.5)


def test_a_replay_starts_where_it_is_told_and_loops(file: Path) -> None:
    with network() as (_, theirs):
        loops = play(theirs, file, Replay(rate=50.0, start_s=1.5, loops=3))
        assert loops == [{POSES: 10, "/sound": 10}] * 3
        with pytest.raises(RecorderError, match="no messages to replay after 99 s"):
            play(theirs, file, Replay(start_s=99.0))


def test_a_replay_can_move_the_stamps_to_now(tmp_path: Path, file: Path) -> None:
    with recording_cell(tmp_path / "again") as cell:
        cell.ask("start", START)
        before_ns = time.time_ns()
        play(cell.session, file, Replay(rate=10.0, restamp=True))
        again = read_recording([Path(cell.ask("stop", {"outcome": "unknown"})["file"])])
    stamps = again.tracks["A"].stamps_ns
    assert before_ns <= stamps[0] < before_ns + 20 * NS
    assert (stamps[-1] - stamps[0]) / NS == pytest.approx(39 / 20 / 10, abs=1e-6)
    assert (again.presses[0].stamp_ns - stamps[0]) / NS == pytest.approx(0.1, abs=1e-6)


def test_a_replay_ends_when_told(file: Path) -> None:
    stopped = threading.Event()
    with network() as (_, theirs):
        loops = replay(theirs, CELL, [file], Replay(loops=None, rate=50.0), stopped, print)
        assert next(loops)
        stopped.set()
        assert list(loops) == []


def written(path: Path, told: list[tuple[str, float]], **more: Any) -> Path:
    """A recording of messages on topics at log times [s]."""
    shown = Demonstrated("d-2", "t", "u", "elsewhere", "base", "tool0", ("A",), outcome="success", **more)
    with RecordingWriter(path, shown) as writer:
        for topic, at_s in told:
            writer.write(topic, b"x", int((1000 + at_s) * NS))
        writer.finish()
    return path


def test_a_gap_is_shortened_and_a_step_back_is_played_on_in_the_order_of_the_file(tmp_path: Path) -> None:
    steps = [0.0, 0.1, 3600.1, 3600.2, 100.0, 100.1, 100.2, 100.3]
    file, said, begun_s = written(tmp_path / "d.mcap", [("/a", at_s) for at_s in steps]), list[str](), time.monotonic()
    with network() as (_, theirs):
        assert play(theirs, file, Replay(max_gap_s=0.5), said) == [{"/a": len(steps)}]
    assert time.monotonic() - begun_s < 5
    assert said == [
        "a gap of 3600.0 s is shortened to 0.5 s",
        "the log's clock steps back by 3500.0 s; the file's order is kept",
    ]


def test_a_topic_that_is_no_key_stops_nothing_and_is_told_once(tmp_path: Path) -> None:
    file, said = written(tmp_path / "d.mcap", [("/a", 0.0), ("/b/*", 0.1), ("/a", 0.2), ("/b/*", 0.3)]), list[str]()
    with network() as (_, theirs):
        assert play(theirs, file, Replay(rate=10.0, loops=2), said) == [{"/a": 2}] * 2
    assert said == ["the topic '/b/*' is a pattern and no key; its messages are left out"]


def test_payloads_that_are_not_of_the_contract_are_not_restamped(tmp_path: Path) -> None:
    file = written(tmp_path / "d.mcap", [(POSES, 0.0), (ACTION, 0.1), ("/gripper", 0.2)])
    with network() as (_, theirs):
        assert play(theirs, file, Replay(rate=10.0, restamp=True)) == [{ACTION: 1, "/gripper": 1, POSES: 1}]


def test_stamps_of_signals_are_moved_too(tmp_path: Path) -> None:
    shown = Demonstrated("d-3", "t", "u", "elsewhere", "base", "tool0", ("A",))
    with RecordingWriter(tmp_path / "d.mcap", shown) as writer:
        writer.write("/signals/door", json.dumps({"stamp_ns": 1000 * NS, "value": True}).encode(), 1000 * NS)
        writer.finish()
    heard, before_ns = list[int](), time.time_ns()
    with (
        network() as (ours, theirs),
        ours.declare_subscriber(f"{PREFIX}/**", lambda s: heard.append(json.loads(s.payload.to_bytes())["stamp_ns"])),
    ):
        time.sleep(0.2)
        play(theirs, tmp_path / "d.mcap", Replay(restamp=True))
        wait_for(lambda: heard)
    assert before_ns <= heard[0] < before_ns + 20 * NS


def test_of_a_damaged_file_nothing_is_played(tmp_path: Path, file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[-200] ^= 0x55
    file.write_bytes(content)
    heard: list[str] = []
    with network() as (ours, theirs), ours.declare_subscriber(f"{PREFIX}/**", lambda s: heard.append(str(s.key_expr))):
        time.sleep(0.2)
        with pytest.raises(RecorderError, match="damaged"):
            play(theirs, file, Replay(rate=50.0))
    assert heard == []


def test_all_caches_together_are_bounded_and_those_that_need_little_have_it_all() -> None:
    def timed(topic: str, size: int, count: int) -> Iterator[Timed]:
        for number in range(count):
            yield Timed(Channel(1, topic, "", {}, 0), number, number, b"x" * size, None)

    cameras = {f"/camera{number}": (0 if number % 2 else 1_000_000) for number in range(40)}
    told = chain(timed(POSES, 300, 1000), *(timed(topic, size, 1) for topic, size in cameras.items()),
                 *(timed(topic, 1_000_000, 20) for topic in cameras))  # fmt: skip
    samples = {topic: count for (topic, _), count in cached_samples(told, threading.Event()).items()}
    assert samples[POSES] == 1000
    assert sum(samples[topic] for topic in cameras) * 1_000_000 + 500_000 <= CACHE_BYTES
    assert sum(samples[topic] for topic in cameras) > 10


def test_the_parts_of_a_split_demonstration_are_played_as_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = written(tmp_path / "one.mcap", [("/a", 0.0)], part=1, continued=True)
    written(tmp_path / "two.mcap", [("/b", 0.1)], part=2)
    assert main(["replay", str(first), "--wait", "0", "--listen", "tcp/127.0.0.1:0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[1])["messages"] == {"/a": 1, "/b": 1}


def test_attachments_are_recorded_beside_their_samples_and_played_with_them(tmp_path: Path) -> None:
    """As other middleware writes: its key has the type and a hash, its attachment sender, time and number."""
    key = f"{PREFIX}/0/chatter/std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503"
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        for number in range(3):
            cell.session.put(key, b"said", attachment=bytes([number] * 33))
        wait_for(lambda: cell.ask("status")["messages"].get(key.removeprefix(PREFIX)) == 3)
        file = Path(cell.ask("stop", {"outcome": "unknown"})["file"])
    kept = [message.data for channel, message in messages(file) if channel.topic.endswith("/@attachment")]
    assert kept == [bytes([number] * 33) for number in range(3)]
    heard: list[bytes] = []
    with network() as (ours, theirs), ours.declare_subscriber(key, lambda s: heard.append(s.attachment.to_bytes())):
        time.sleep(0.2)
        play(theirs, file, Replay(rate=10.0))
        wait_for(lambda: len(heard) == 3)
    assert heard == kept


def test_the_command_replays(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(file), "--rate", "40", "--wait", "0", "--listen", "tcp/127.0.0.1:0", "--json"]) == 0
    ready, loop = map(json.loads, capsys.readouterr().out.splitlines())
    assert ready == {"ready": True}
    assert loop == {"loop": 1, "messages": {ACTION: 1, POSES: 40, "/sound": 40}}


def test_a_cell_that_is_no_name_and_a_file_that_is_not_there_are_refused_before_anything_is_said(
    tmp_path: Path, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, reason in (
        ([str(file), "--cell", "a/**"], "cell name 'a/**' is refused"),
        ([str(tmp_path / "no.mcap"), "--cell", CELL], f"treewright: {tmp_path / 'no.mcap'}: No such file or directory"),
    ):
        assert main(["replay", *words, "--json"]) == 1
        said = capsys.readouterr()
        assert said.out == ""
        assert reason in said.err


def test_a_replayed_and_recorded_demonstration_learns_to_the_same_tree(tmp_path: Path) -> None:
    files = sorted(SAMPLES.glob("object_in_box-*.mcap"))
    if not files:
        pytest.skip(f"{SAMPLES} is not here")
    again: list[Recording] = []
    with recording_cell(tmp_path) as cell:
        for file in files:
            header = read_header(file)
            request = {
                "task": header.task,
                "user": header.user,
                "objects": list(header.objects),
                "base_frame": header.base_frame,
                "end_effector_frame": header.end_effector_frame,
                "scene": json.loads(header.scene or "null"),
                "unseen_ok": True,
            }
            cell.ask("start", request)
            play(cell.session, file, Replay(rate=8.0))
            stopped = cell.ask("stop", {"outcome": "success"})
            assert stopped["lost"] == {ACTION: 0, "/gripper": 0, POSES: 0}
            again.append(read_recording([Path(stopped["file"])]))
    first = learn([observe(read_recording([file])) for file in files])
    second = learn([observe(recording) for recording in again])
    assert second.tree == first.tree
