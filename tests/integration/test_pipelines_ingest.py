"""Ingest: what is new goes to the lake, what breaks the contract to quarantine with one sentence, twice is once."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support_recordings import Take, object_in_box

from pipelines.cli import main
from pipelines.home import Home
from pipelines.steps.ingest import IngestResult, ingest
from recorder.recording import sha256_of
from storage.lake import Lake

SAMPLES = Path(__file__).parents[3] / "shared" / "data" / "contract_samples"


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    monkeypatch.setenv("TREEWRIGHT_HOME", str(tmp_path / "home"))
    return Home.current()


def ingested(home: Home, *named: Path) -> IngestResult:
    return ingest(home, Lake(home.lake), named)


def only_reason(result: IngestResult) -> str:
    (refused,) = result.quarantined
    return refused.reason


def test_what_lies_below_recordings_is_ingested_once(home: Home) -> None:
    for seed in range(3):
        object_in_box(seed).write(home.recordings / "bench" / f"{seed}.mcap")
    first, second = ingested(home), ingested(home)
    assert [d.demonstration_id for d in first.ingested] == ["object_in_box-0", "object_in_box-1", "object_in_box-2"]
    assert first.tasks == ("object_in_box",)
    assert not second.ingested
    assert second.known == ("object_in_box-0", "object_in_box-1", "object_in_box-2")
    assert len(Lake(home.lake).demonstrations()) == 3


def test_each_demonstration_of_a_batch_leads_back_to_its_own_file(home: Home) -> None:
    files = [object_in_box(seed).write(home.recordings / f"{seed}.mcap") for seed in range(2)]
    ingested(home)
    judged = Lake(home.lake).files.of(set(map(str, files)))
    assert {file: each.demonstration_id for file, each in judged.items()} == {
        str(file): f"object_in_box-{seed}" for seed, file in enumerate(files)
    }
    assert [judged[str(file)].sha256 for file in files] == [sha256_of([file]) for file in files]


def test_the_same_content_under_another_name_is_known(home: Home, tmp_path: Path) -> None:
    file = object_in_box(1).write(tmp_path / "a.mcap")
    copy = Path(shutil.copy(file, tmp_path / "b.mcap"))
    result = ingested(home, file, copy)
    assert len(result.ingested) == 1
    assert ingested(home, copy).known == ("object_in_box-1",)


def test_an_unfinished_recording_is_left_alone(home: Home) -> None:
    object_in_box(1).write(home.recordings / "1.mcap.part")
    assert ingested(home) == IngestResult((), (), (), ())


def test_the_same_id_with_other_content_is_quarantined(home: Home, tmp_path: Path) -> None:
    file = object_in_box(1).write(tmp_path / "a.mcap")
    other = object_in_box(2, demonstration_id="object_in_box-1").write(tmp_path / "b.mcap")
    together = ingested(home, file, other)
    assert len(together.ingested) == 1
    assert "already stored with other content" in only_reason(together)
    assert "already stored with other content" in only_reason(ingested(home, other))
    assert len(Lake(home.lake).demonstrations()) == 1


def test_a_file_that_changed_under_its_name_is_judged_again(home: Home) -> None:
    file = home.recordings / "1.mcap"
    object_in_box(1).saying(contract="2").write(file)
    assert "contract" in only_reason(ingested(home))
    object_in_box(1).write(file)
    assert len(ingested(home).ingested) == 1
    assert Lake(home.lake).quarantined() == []


def without_poses_of(name: str) -> Callable[[Take], Take]:
    return lambda take: take.without(lambda message: message[1] != "/poses" or name.encode() not in message[2])


def picked_twice(take: Take) -> Take:
    pick, drop = take.presses()
    return take.with_presses([pick, {**drop, "type": "pick"}])


def early(take: Take) -> Take:
    """The pick is pressed before the end-effector was ever seen."""
    pick, drop = take.presses()
    return take.with_presses([{**pick, "stamp_ns": take.messages[0][0]}, drop])


def against_the_gripper(take: Take) -> Take:
    """The pick is pressed while the gripper is closed: after the real pick's end."""
    pick, drop = take.presses()
    return take.with_presses([{**pick, "stamp_ns": pick["stamp_ns"] + 500_000_000}, drop])


BREAKS: dict[str, tuple[Callable[[Take], Take], str]] = {
    "unknown contract version": (lambda take: take.saying(contract="9"), "version '9' of the contract"),
    "bad task name": (lambda take: take.saying(task="../etc"), "task name '../etc' is refused"),
    "bad user name": (lambda take: take.saying(user=""), "user name '' is refused"),
    "bad cell name": (lambda take: take.saying(cell="artifacts"), "cell name 'artifacts' is refused"),
    "reserved object name": (lambda take: take.saying(objects='["none"]'), "object name 'none' is refused"),
    "bad frame name": (lambda take: take.saying(base_frame="a b"), "frame name 'a b' is refused"),
    "bad outcome": (lambda take: take.saying(outcome="fine"), "outcome is 'fine'"),
    "bad objects": (lambda take: take.saying(objects="A, box"), "objects"),
    "object never seen": (lambda take: take.saying(objects='["A", "box", "lid"]'), "lid was never seen"),
    "no end-effector": (lambda take: take.saying(end_effector_frame="flange"), "flange was never seen"),
    "no action": (
        lambda take: take.with_presses([]).without(lambda message: message[1] != "/gripper"),
        "no action was demonstrated, nor did the gripper close on anything",
    ),
    "picked while holding": (picked_twice, "picks while A is held"),
    "no fresh pose": (early, "no fresh pose"),
    "contradicts the gripper": (against_the_gripper, "contradicts the gripper"),
    "no poses at all": (lambda take: take.without(lambda message: message[1] != "/poses"), "never seen"),
}


@pytest.mark.parametrize("case", BREAKS)
def test_what_breaks_the_contract_is_quarantined_with_the_reason(case: str, home: Home, tmp_path: Path) -> None:
    breaks, words = BREAKS[case]
    bad = breaks(object_in_box(1)).write(tmp_path / "bad.mcap")
    good = object_in_box(2).write(tmp_path / "good.mcap")
    content = bad.read_bytes()
    result = ingested(home, bad, good)
    assert words in only_reason(result)
    assert [demonstration.demonstration_id for demonstration in result.ingested] == ["object_in_box-2"]
    (record,) = Lake(home.lake).quarantined()
    assert words in record.reason
    assert bad.read_bytes() == content == (home.quarantine / f"{record.sha256}.mcap").read_bytes()


def test_a_torn_file_is_quarantined_and_says_how_to_save_it(home: Home) -> None:
    file = object_in_box(1).write(home.recordings / "torn.mcap")
    file.write_bytes(file.read_bytes()[:-2000])
    assert "treewright recover" in only_reason(ingested(home))
    assert file.exists()


@pytest.mark.parametrize("content", [b"", b"hello, this is no recording", bytes(5000)])
def test_what_is_no_mcap_is_quarantined(content: bytes, home: Home, tmp_path: Path) -> None:
    file = tmp_path / "no.mcap"
    file.write_bytes(content)
    assert str(file) in only_reason(ingested(home, file))


def test_a_file_without_the_metadata_record_is_quarantined(home: Home, tmp_path: Path) -> None:
    take = object_in_box(1)
    take.metadata.clear()
    assert "lacks" in only_reason(ingested(home, take.write(tmp_path / "bare.mcap")))


def test_a_missing_file_is_named_and_leaves_nothing_behind(home: Home, tmp_path: Path) -> None:
    result = ingested(home, tmp_path / "gone.mcap", object_in_box(1).write(tmp_path / "here.mcap"))
    assert "there is no such file" in only_reason(result)
    assert len(result.ingested) == 1
    assert Lake(home.lake).quarantined() == []


def test_what_was_refused_is_told_again_only_when_named(home: Home) -> None:
    file = object_in_box(1).saying(task="a b").write(home.recordings / "bad.mcap")
    assert len(ingested(home).quarantined) == 1
    assert ingested(home).quarantined == ()
    assert len(ingested(home, file).quarantined) == 1
    assert len(Lake(home.lake).quarantined()) == 1


def test_a_split_demonstration_counts_once_all_parts_are_there(home: Home) -> None:
    first, second = object_in_box(1).halves()
    first.write(home.recordings / "1.mcap")
    alone = ingested(home)
    assert (alone.ingested, alone.quarantined) == ((), ())
    assert [waiting.parts for waiting in alone.waiting] == [(1,)]
    second.write(home.recordings / "2.mcap")
    whole = ingested(home)
    assert [(d.demonstration_id, d.outcome) for d in whole.ingested] == [("object_in_box-1", "success")]
    assert [action.type for action in Lake(home.lake).demonstrations()[0].actions] == ["pick", "drop"]
    assert ingested(home).known == ("object_in_box-1",)


def test_a_named_part_finds_the_others_beside_it(home: Home, tmp_path: Path) -> None:
    first, second = object_in_box(1).halves()
    files = first.write(tmp_path / "1.mcap"), second.write(tmp_path / "2.mcap")
    assert len(ingested(home, files[1]).ingested) == 1
    assert ingested(home, *files).known == ("object_in_box-1",)


def test_parts_named_in_different_folders_are_joined(home: Home, tmp_path: Path) -> None:
    first, second = object_in_box(1).halves()
    folders = tmp_path / "disk-1", tmp_path / "disk-2"
    for folder in folders:
        folder.mkdir()
    files = first.write(folders[0] / "1.mcap"), second.write(folders[1] / "2.mcap")
    done = ingested(home, *files)
    assert len(done.ingested) == 1
    assert done.waiting == ()


def test_the_command_prints_one_document_and_exits_1_after_doing_the_rest(
    home: Home, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = object_in_box(1).write(tmp_path / "good.mcap")
    bad = object_in_box(2).saying(contract="7").write(tmp_path / "bad.mcap")
    assert main(["ingest", "--json", str(bad), str(good)]) == 1
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert document["ingested"] == ["object_in_box-1"]
    assert document["known"] == []
    assert [refused["file"] for refused in document["quarantined"]] == [str(bad)]
    assert len(err.splitlines()) == 1
    assert "bad.mcap" in err
    assert main(["ingest", "--json", str(good)]) == 0
    assert json.loads(capsys.readouterr().out) == {"ingested": [], "known": ["object_in_box-1"], "quarantined": []}


def test_a_data_root_that_is_a_file_is_one_clear_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "root"
    root.write_text("not a folder")
    monkeypatch.setenv("TREEWRIGHT_HOME", str(root))
    assert main(["ingest", str(object_in_box(1).write(tmp_path / "a.mcap"))]) == 1
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert "lake" in err


@pytest.mark.skipif(not SAMPLES.exists(), reason="the sample recordings are not here")
def test_recordings_by_another_writer_are_ingested_as_they_are(home: Home) -> None:
    result = ingested(home, SAMPLES)
    assert (len(result.ingested), result.quarantined) == (14, ())


def test_a_label_that_does_not_fit_the_height_of_release_is_doubted_with_the_evidence(
    home: Home, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    take = object_in_box(1)
    pick, drop = take.presses()
    file = take.with_presses([pick, {**drop, "type": "place"}]).write(tmp_path / "placed.mcap")
    assert main(["ingest", "--json", str(file)]) == 0
    (sentence,) = json.loads(capsys.readouterr().out)["doubts"]["object_in_box-1"]
    assert " mm above its rest, which fits a drop" in sentence
    assert "treewright relabel object_in_box-1 1 drop" in sentence


def test_a_full_disk_is_one_clear_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = object_in_box(1).write(tmp_path / "a.mcap")
    with tiny_disk(tmp_path / "tiny") as disk, pytest.MonkeyPatch.context() as patch:
        patch.setenv("TREEWRIGHT_HOME", str(disk / "home"))
        assert main(["ingest", str(file)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "left; free some room" in line


@contextmanager
def tiny_disk(folder: Path) -> Iterator[Path]:
    """A file system of 64 KiB; skips the test where we may not mount one."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("only the superuser may mount a small disk")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)
