"""The recorder on a real network: the contract's section 1."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
import zenoh
from support_recorder import CELL, PREFIX, START, Cell, Refused, answers, ask, network, recording_cell, wait_for

from learner.model import Pose
from recorder.daemon import Options, Recorder
from recorder.errors import DiskError, SecondRecorderError
from recorder.intake.patterns import Patterns
from recorder.recording import messages, read_header, read_recording, sha256_of

POSES = {"tool0": Pose((0.5, 0.0, 0.3)), "A": Pose((0.5, 0.0, 0.02)), "B": Pose((0.4, 0.1, 0.02))}


def demonstrate(cell: Cell, seconds: float = 0.3) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        cell.put_poses(POSES)
        time.sleep(0.01)


def test_a_demonstration_becomes_a_file_that_says_what_is_in_it(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        started = cell.ask("start", START)
        cell.put_json("gripper", {"stamp_ns": time.time_ns(), "state": "open", "width_m": 0.08})
        demonstrate(cell)
        pressed_ns = cell.press("pick", object="A")
        cell.session.put(f"{PREFIX}/camera/image", b"\x00\x01\xff", encoding="image/jpeg")
        wait_for(lambda: cell.ask("status")["messages"].get("/camera/image"))
        stopped = cell.ask("stop", {"outcome": "success"})
    file = Path(stopped["file"])
    assert file.is_absolute()
    assert (started["file"], started["demonstration_id"]) == (stopped["file"], stopped["demonstration_id"])
    assert stopped["sha256"] == sha256_of([file])
    assert stopped["lost"] == {"/action": None, "/camera/image": None, "/gripper": None, "/poses": 0}
    found = list(messages(file))
    assert stopped["messages"] == {
        topic: sum(channel.topic == topic for channel, _ in found) for topic in stopped["messages"]
    }
    (image,) = [(channel, message) for channel, message in found if channel.topic == "/camera/image"]
    assert (image[0].metadata["zenoh_encoding"], image[1].data) == ("image/jpeg", b"\x00\x01\xff")
    recording = read_recording([file])
    assert (recording.outcome, recording.cell, recording.objects) == ("success", CELL, ("A", "B"))
    assert [press.stamp_ns for press in recording.presses] == [pressed_ns]
    assert recording.messages_lost == stopped["lost"]
    assert not list(tmp_path.glob("*.part"))


def test_events_and_status_tell_what_happens(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        heard: list[dict[str, object]] = []
        with cell.session.declare_subscriber(
            f"{PREFIX}/recorder/events", lambda sample: heard.append(json.loads(sample.payload.to_bytes()))
        ):
            assert cell.ask("status")["state"] == "idle"
            cell.ask("start", START)
            assert cell.ask("status")["state"] == "recording"
            assert cell.ask("pause")["state"] == "paused"
            assert cell.ask("resume")["state"] == "recording"
            demonstrate(cell)
            cell.press("pick")
            wait_for(lambda: cell.ask("status")["actions_durable"] == 1)
            assert cell.ask("status")["disk_free_bytes"] > 0
            cell.ask("stop", {"outcome": "failure"})
            wait_for(lambda: "stop" in [event["event"] for event in heard])
        names = [event["event"] for event in heard]
        assert [name for name in names if name not in ("action", "durable")] == ["start", "pause", "resume", "stop"]
        assert all(isinstance(event["stamp_ns"], int) for event in heard)


def test_the_recorder_is_seen_to_be_alive(tmp_path: Path) -> None:
    with network() as (ours, theirs):
        key = f"{PREFIX}/recorder/alive"
        with Recorder(ours, CELL, tmp_path):
            wait_for(lambda: [reply for reply in theirs.liveliness().get(key, timeout=1.0) if reply.ok])
        wait_for(lambda: not [reply for reply in theirs.liveliness().get(key, timeout=1.0) if reply.ok])


def test_a_second_recorder_for_a_cell_refuses_to_start(tmp_path: Path) -> None:
    with network() as (ours, theirs), Recorder(ours, CELL, tmp_path / "one"):
        wait_for(lambda: answers(theirs))
        with pytest.raises(SecondRecorderError, match="cell1 already has a recorder"), Recorder(theirs, CELL, tmp_path):
            pass
        with Recorder(theirs, "cell2", tmp_path / "two"):
            wait_for(lambda: answers(ours, prefix="treewright/cell2"))
        assert ask(theirs, "status")["state"] == "idle"


@pytest.mark.parametrize(
    ("verb", "request_", "sentence"),
    [
        ("start", b"{", "start is not JSON"),
        ("start", b"[1]", "is a JSON object"),
        ("start", {}, "lacks task, user, objects, base_frame, end_effector_frame"),
        ("start", {**START, "task": "../../etc/passwd"}, "task name '../../etc/passwd' is refused"),
        ("start", {**START, "user": ""}, "user name '' is refused"),
        ("start", {**START, "objects": []}, "at least one name"),
        ("start", {**START, "objects": "A"}, "at least one name"),
        ("start", {**START, "objects": ["none"]}, "object name 'none' is refused"),
        ("start", {**START, "objects": ["A", "A"]}, "names of their own"),
        ("start", {**START, "objects": ["tool0"]}, "names of their own"),
        ("start", {**START, "base_frame": "a/b"}, "frame name 'a/b' is refused"),
        ("start", {**START, "scene": {"objects": {"A": {}}}}, "scene is not as the contract"),
        ("stop", {"outcome": "success"}, "cannot stop: nothing is being recorded in cell1"),
        ("stop", {"outcome": "perfect"}, "outcome of a stop is success, failure, unknown"),
        ("discard", {}, "cannot discard"),
        ("pause", {}, "cannot pause"),
        ("resume", {}, "cannot resume"),
        ("split", {}, "cannot split"),
        ("dance", {}, "knows start, stop"),
    ],
)
def test_a_request_that_cannot_be_fulfilled_is_answered_with_why(
    idle_cell: Cell, verb: str, request_: object, sentence: str
) -> None:
    with pytest.raises(Refused, match=sentence):
        idle_cell.ask(verb, request_)
    assert idle_cell.ask("status")["state"] == "idle"


@pytest.fixture(scope="module")
def idle_cell(tmp_path_factory: pytest.TempPathFactory) -> object:
    with recording_cell(tmp_path_factory.mktemp("idle")) as cell:
        yield cell


def test_two_starts_are_one_demonstration(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        started = cell.ask("start", START)
        with pytest.raises(Refused, match=f"{started['demonstration_id']} is recording"):
            cell.ask("start", START)
        assert cell.ask("stop", {"outcome": "success"})["demonstration_id"] == started["demonstration_id"]


def test_an_action_while_nothing_is_recorded_is_an_alarm(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        cell.press("pick")
        alarm = cell.await_event("alarm")["alarm"]
        assert "the action pick is not recorded" in alarm
        assert cell.ask("status")["alarms"] == [alarm]
        cell.ask("start", START)
        assert cell.ask("status")["alarms"] == []
        cell.ask("pause")
        cell.press("place")
        wait_for(lambda: any("the action place is not recorded" in alarm for alarm in cell.ask("status")["alarms"]))


def test_the_pre_roll_is_poses_and_gripper_but_never_from_before_a_stop(tmp_path: Path) -> None:
    with recording_cell(tmp_path, Options(pre_roll_s=30.0)) as cell:
        early_ns = cell.put_poses(POSES)
        cell.put_json("gripper", {"stamp_ns": early_ns, "state": "open", "width_m": None})
        cell.put_json("camera", {"n": 1})
        before_ns = cell.ask_now()
        first = cell.ask("start", START)
        cell.put_json("camera", {"n": 2})
        wait_for(lambda: cell.ask("status")["messages"].get("/camera"))
        file = Path(cell.ask("stop", {"outcome": "success"})["file"])
        between_ns = cell.put_poses(POSES)
        cell.ask_now()
        cell.ask("start", START)
        second = Path(cell.ask("stop", {"outcome": "success"})["file"])
    assert str(file) == first["file"]
    header = read_header(file)
    assert header.start_ns is not None
    assert header.start_ns >= before_ns
    logged = [(channel.topic, message.log_time < header.start_ns) for channel, message in messages(file)]
    assert logged == [("/poses", True), ("/gripper", True), ("/camera", False)]
    assert read_recording([file]).tracks["A"].stamps_ns.tolist() == [early_ns]
    assert read_recording([second]).tracks["A"].stamps_ns.tolist() == [between_ns]


def test_what_the_contract_leaves_out_is_not_recorded(tmp_path: Path) -> None:
    with recording_cell(tmp_path, Options(patterns=Patterns(exclude=["camera/**"]))) as cell:
        cell.ask("start", START)
        for key in ("recorder/x", "skills/Pick/x", "@private/x", "a/@b/x", "camera/image", "force"):
            cell.session.put(f"{PREFIX}/{key}", b"x")
        cell.session.put("treewright/cell10/force", b"another cell")
        wait_for(lambda: cell.ask("status")["messages"])
        assert cell.ask("stop", {"outcome": "success"})["messages"] == {"/force": 1}


def test_patterns_include_and_exclude() -> None:
    patterns = Patterns(include=["camera/**", "force"], exclude=["**/depth"])
    admitted = [
        topic for topic in ("/camera/rgb", "/camera/depth", "/force", "/sound", "/poses") if patterns.admit(topic)
    ]
    assert admitted == ["/camera/rgb", "/force", "/poses"]


def test_nothing_is_recorded_while_paused(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        one = cell.put_poses(POSES)
        wait_for(lambda: cell.ask("status")["messages"].get("/poses") == 1)
        cell.ask("pause")
        before = cell.recorder.receiver.received_bytes
        cell.put_poses(POSES)
        wait_for(lambda: cell.recorder.receiver.received_bytes > before)
        cell.ask("resume")
        two = cell.put_poses(POSES)
        wait_for(lambda: cell.ask("status")["messages"].get("/poses") == 2)
        stopped = cell.ask("stop", {"outcome": "success"})
    assert read_recording([Path(stopped["file"])]).tracks["A"].stamps_ns.tolist() == [one, two]
    assert stopped["lost"] == {"/poses": 0}


def test_a_discarded_demonstration_leaves_nothing(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        demonstrate(cell)
        assert cell.ask("discard")["state"] == "idle"
    assert [path for path in tmp_path.iterdir() if ".mcap" in path.name] == []


def test_a_split_demonstration_is_whole_once_its_parts_are_joined(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        stamps = []
        for part in range(3):
            for _ in range(20):
                stamps.append(cell.put_poses(POSES))
                time.sleep(0.002)
            wait_for(lambda: sum(cell.ask("status")["messages"].values()) == 20)
            if part < 2:
                cell.ask("split")
        stopped = cell.ask("stop", {"outcome": "success"})
    headers = [read_header(Path(file)) for file in stopped["parts"]]
    assert [(header.part, header.continued) for header in headers] == [(1, True), (2, True), (3, False)]
    assert {header.demonstration_id for header in headers} == {stopped["demonstration_id"]}
    recording = read_recording([Path(file) for file in stopped["parts"]])
    assert recording.tracks["A"].stamps_ns.tolist() == stamps
    assert recording.outcome == "success"


def test_a_recording_splits_by_itself_at_a_size_or_a_duration(tmp_path: Path) -> None:
    for folder, options in (("size", Options(split_bytes=200_000)), ("duration", Options(split_s=0.5))):
        with recording_cell(tmp_path / folder, options) as cell:
            cell.ask("start", START)
            noise = json.dumps([hash((i, folder)) for i in range(2000)]).encode()

            def split(cell: Cell = cell, noise: bytes = noise) -> bool:
                cell.session.put(f"{PREFIX}/noise", noise, congestion_control=zenoh.CongestionControl.BLOCK)
                return any(event["event"] == "split" for event in cell.events)

            wait_for(split)
            assert len(cell.ask("stop", {"outcome": "success"})["parts"]) >= 2


def test_leaving_closes_an_open_recording_with_outcome_unknown(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        file = Path(cell.ask("start", START)["file"])
        demonstrate(cell)
    assert read_header(file).outcome == "unknown"
    assert len(read_recording([file]).tracks["A"].stamps_ns) > 5


def test_a_data_root_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with (
        network() as (ours, _),
        pytest.raises(DiskError, match=r"cannot be written .*TREEWRIGHT_HOME"),
        Recorder(ours, CELL, tmp_path / "file" / "recordings"),
    ):
        pass


def test_an_advanced_subscribers_traps_do_not_lose_plain_samples(tmp_path: Path) -> None:
    """Plain samples of one session whose stamps overtake each other: all are kept, and their loss is unknowable."""
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        early, late = cell.session.new_timestamp(), None
        time.sleep(0.01)
        late = cell.session.new_timestamp()
        cell.session.put(f"{PREFIX}/one", b"late", timestamp=late)
        cell.session.put(f"{PREFIX}/two", b"early", timestamp=early)
        wait_for(lambda: cell.ask("status")["messages"] == {"/one": 1, "/two": 1})
        assert cell.ask("stop", {"outcome": "success"})["lost"] == {"/one": None, "/two": None}


def test_the_teacher_is_told_at_once_which_marker_was_not_seen(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        for _ in range(10):
            cell.put_poses({"tool0": POSES["tool0"], "A": POSES["A"]})
            time.sleep(0.01)
        cell.press("pick", object="A")
        told = cell.await_event("action")
        assert told["unseen"] == ["B"]
        assert "the marker of B was not seen" in told["findings"][0]
        assert cell.ask("status")["unseen"] == ["B"]
        demonstrate(cell)
        cell.events.clear()
        cell.press("pick", object="A")
        assert cell.await_event("action")["unseen"] == []
        assert cell.ask("status")["unseen"] == []


def test_the_teacher_is_told_of_a_marker_that_jumps(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        for step in range(10):
            cell.put_poses({**POSES, "B": Pose((0.4, 0.3 * (step == 5), 0.02))})
            time.sleep(0.01)
        cell.press("pick", object="A")
        told = cell.await_event("action")
        assert told["unseen"] == []
        assert "the marker of B jumped by 30 cm" in told["findings"][0]


def test_poses_that_arrive_after_the_press_still_count(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        pose_ns = time.time_ns()
        cell.press("pick", stamp_ns=pose_ns + 1_000_000)
        time.sleep(0.1)
        cell.put_poses(POSES, stamp_ns=pose_ns)
        told = cell.await_event("action")
        assert (told["unseen"], told["findings"]) == ([], [])
