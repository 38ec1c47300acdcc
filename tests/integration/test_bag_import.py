"""Other people's bags: rosbag2 in both storages becomes a recording from which the same is learned."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from experiments.demonstrator import demonstrate
from experiments.scenarios import SCENARIOS
from experiments.users import EXPERT
from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin
from support_bags import BagMaker, a_bool, a_width, bag_of, joints, message, transform

from learner.learning import learn
from learner.model import Demonstration, Pose, Recording
from learner.observation import observe
from pipelines.cli import main
from recorder.recording import read_recording

HERE = Pose((0.5, 0.1, 0.2))
NS = 1_000_000_000


@pytest.fixture(autouse=True)
def _home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TREEWRIGHT_HOME", str(tmp_path / "home"))


@pytest.fixture(scope="module")
def shown() -> list[Recording]:
    return [demonstrate(SCENARIOS["tower_and_box"], np.random.default_rng([11, n]), EXPERT, n) for n in range(3)]


def imported(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    capsys.readouterr()
    assert main(["import", *arguments, "--task", "t", "--user", "ann", "--json"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    capsys.readouterr()
    assert main(["import", *arguments, "--task", "t", "--user", "ann"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "Traceback" not in line
    return line


def done(demonstration: Demonstration) -> list[tuple[str, str]]:
    return [(action.type, action.object) for action in demonstration.actions]


def test_a_bag_is_learned_from_as_the_recording_is(
    shown: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three bags: MCAP and SQLite, a bool, a width and a joint, stamps of the recording's clock and of another."""
    ways = [
        ("/gripper_closed", a_bool, StoragePlugin.MCAP, 0, ()),
        ("/width", a_width, StoragePlugin.SQLITE3, -1_700_000_000 * NS, ()),
        ("/joint_states", joints, StoragePlugin.MCAP, 0, ("--gripper-joint", "finger")),
    ]
    found = []
    for number, (recording, (topic, say, storage, offset_ns, more)) in enumerate(zip(shown, ways, strict=True)):
        bag = bag_of(recording, say, topic, offset_ns).write(tmp_path / f"bag{number}", storage)
        (file,) = imported(capsys, str(bag), "--gripper", topic, *more)["imported"]
        found.append(observe(read_recording([Path(file)])))
    plain = [observe(replace(recording, presses=(), scene=None)) for recording in shown]
    assert [done(each) for each in found] == [done(each) for each in plain]
    assert {each.objects for each in found} == {("A", "D", "E", "F", "box")}
    for one, other in zip(found, plain, strict=True):
        for mine, theirs in zip(one.actions, other.actions, strict=True):
            assert np.allclose(mine.end_effector.position, theirs.end_effector.position, atol=2e-3)
            assert np.allclose(mine.objects[mine.object].position, theirs.objects[mine.object].position, atol=2e-3)
    targets = [[(a["type"], a["object"], a["frame"]) for a in learn(each).report["actions"]] for each in (found, plain)]
    assert targets[0] == targets[1]


def test_a_single_file_is_imported_and_a_second_time_it_is_known(
    shown: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By its content, whatever holds it."""
    for number, (storage, ending) in enumerate(((StoragePlugin.MCAP, "*.mcap"), (StoragePlugin.SQLITE3, "*.db3"))):
        (file,) = bag_of(shown[number]).write(tmp_path / ending[2:], storage).glob(ending)
        first = imported(capsys, str(file), "--gripper", "/gripper_closed")
        assert len(first["imported"]) == 1
        assert imported(capsys, str(file), "--gripper", "/gripper_closed")["known"] == first["imported"]


def test_what_learning_does_not_need_is_kept_byte_for_byte(
    shown: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = bag_of(shown[0]).write(tmp_path / "bag")
    (file,) = imported(capsys, str(bag), "--gripper", "/gripper_closed")["imported"]
    with Path(file).open("rb") as stream:
        kept = [(s, c, m) for s, c, m in make_reader(stream).iter_messages() if c.topic == "/rosout"]
    ((schema, channel, found),) = kept
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == ("std_msgs/msg/String", "ros2msg", "cdr")
    assert b"hello" in found.data


def test_presses_in_a_bag_are_taken_for_presses(
    shown: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    maker, recording = bag_of(shown[0]), shown[0]
    for press in recording.presses:
        text = json.dumps({"stamp_ns": press.stamp_ns, "type": press.type, "object": press.object})
        maker.say(press.stamp_ns, "/action", "std_msgs/msg/String", message("std_msgs/msg/String", data=text))
    bag = maker.write(tmp_path / "bag")
    (file,) = imported(capsys, str(bag), "--gripper", "/gripper_closed")["imported"]
    found = read_recording([Path(file)])
    assert [(p.type, p.object) for p in found.presses] == [(p.type, p.object) for p in recording.presses]


def test_frames_are_chosen_by_pattern_and_named_as_the_contract_admits(
    shown: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = bag_of(shown[0], names=lambda name: f"/tags/{name}").write(tmp_path / "bag")
    options = ("--gripper", "/gripper_closed", "--base", "base", "--end-effector", "tool0", "--objects", "tags/[AB]*")
    (file,) = imported(capsys, str(bag), *options)["imported"]
    assert read_recording([Path(file)]).objects == ("tags_A",)


def test_what_is_missing_is_named_with_what_the_bag_holds(
    shown: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = str(bag_of(shown[0]).write(tmp_path / "bag"))
    assert "--gripper" in (line := refused(capsys, bag))
    assert "/gripper_closed (std_msgs/msg/Bool" in line
    assert "no topic /hand" in (line := refused(capsys, bag, "--gripper", "/hand"))
    assert "/tf (tf2_msgs/msg/TFMessage" in line
    assert "messages of type std_msgs/msg/String" in refused(capsys, bag, "--gripper", "/rosout")
    told = ("--gripper", "/gripper_closed")
    assert "no frame 'map'; name one with --base" in refused(capsys, bag, *told, "--base", "map")
    assert "no frame 'hand'; name one with --end-effector" in refused(capsys, bag, *told, "--end-effector", "hand")
    assert "no frame matches lid*" in (line := refused(capsys, bag, *told, "--objects", "lid*"))
    assert "camera" in line


def broken(tmp_path: Path, what: str) -> Path:
    """A bag in which something is odd."""
    maker = BagMaker()
    maker.say(NS, "/g", "std_msgs/msg/Bool", a_bool("open"))
    maker.say(2 * NS, "/g", "std_msgs/msg/Bool", a_bool("closed"))
    if what == "no transforms":
        return maker.write(tmp_path / "bag")
    parents = {"ring": "A", "two parents": "base", "no rotation": "base", "apart": "base"}
    for number in range(3):
        at_ns = (1 + number) * NS
        maker.tf(at_ns, transform("base", "tool0", HERE, at_ns))
        told = transform(parents[what], "C" if what == "ring" else "B", HERE, at_ns)
        if what == "no rotation":
            told.transform.rotation.w = 0.0
        maker.tf(at_ns, told)
        if what == "ring":
            maker.tf(at_ns, transform("C", "A", HERE, at_ns))
        if what == "two parents":
            maker.tf(at_ns, transform("tool0", "B", HERE, at_ns))
        if what == "apart":
            maker.tf(at_ns, transform("elsewhere", "A", HERE, at_ns))
    return maker.write(tmp_path / "bag")


@pytest.mark.parametrize(
    ("what", "objects", "words"),
    [
        ("no transforms", "B", "it has no transforms"),
        ("ring", "A", "form a ring"),
        ("two parents", "B", "several parents, base and tool0"),
        ("no rotation", "B", "no frame matches B"),
        ("apart", "A", "no chain of transforms leads from base to A"),
    ],
)
def test_a_bag_that_is_odd_gets_one_sentence(
    what: str, objects: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert words in refused(capsys, str(broken(tmp_path, what)), "--gripper", "/g", "--objects", objects)


def test_what_is_no_bag_gets_one_sentence(
    shown: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = ("--gripper", "/g")
    assert "is no rosbag2" in refused(capsys, str(tmp_path / "nothing.mcap"), *told)
    for name in ("noise.mcap", "noise.db3"):
        (tmp_path / name).write_bytes(bytes(range(256)) * 10)
        assert "is no rosbag2 that can be read" in refused(capsys, str(tmp_path / name), *told)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "metadata.yaml").write_text("a: [")
    assert "is no rosbag2 that can be read" in refused(capsys, str(tmp_path / "folder"), *told)
    bag = bag_of(shown[0]).write(tmp_path / "bag")
    (file,) = bag.glob("*.mcap")
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    assert "cannot be imported" in refused(capsys, str(file), "--gripper", "/gripper_closed")
