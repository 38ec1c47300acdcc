"""The lake of demonstrations."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from support_demonstrations import DEMONSTRATIONS, demonstration

from learner.model import Demonstration
from storage.errors import ConflictError, NotStoredError, RelabelRefusedError, StorageUnavailableError
from storage.lake import Lake
from storage.table import Table


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return Lake(tmp_path / "lake")


@given(DEMONSTRATIONS)
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_every_demonstration_comes_back_exactly(given_one: Demonstration) -> None:
    with tempfile.TemporaryDirectory() as folder:
        lake = Lake(Path(folder))
        assert lake.add(given_one)
        assert lake.demonstrations() == [given_one]
        assert lake.entry(given_one.demonstration_id).demonstration == given_one


def test_an_empty_lake_is_read_as_empty_and_not_created(lake: Lake) -> None:
    assert lake.demonstrations() == []
    assert (lake.known(), lake.files.of({"a"}), lake.stored({"d1"}), lake.quarantined()) == ({}, {}, {}, [])
    assert not lake.root.exists()


def test_adding_twice_changes_nothing(lake: Lake) -> None:
    assert lake.add(demonstration())
    assert not lake.add(demonstration())
    assert not Lake(lake.root).add(demonstration())
    assert lake.demonstrations() == [demonstration()]


def test_many_are_added_in_one_commit_and_read_in_the_order_of_their_start(lake: Lake) -> None:
    late, early = demonstration("b"), replace(demonstration("c"), start_ns=1)
    assert lake.add_all([late, early, late]) == [True, True, False]
    assert lake.demonstrations() == [early, late]
    assert [len(list((lake.root / name / "_delta_log").glob("*1.json"))) for name in ("actions", "demonstrations")] == [
        1,
        1,
    ]


def test_the_same_id_with_other_content_is_a_conflict_and_nothing_of_the_batch_is_ingested(lake: Lake) -> None:
    lake.add(demonstration("d1"))
    with pytest.raises(ConflictError, match="d1"):
        lake.add_all([demonstration("d2"), demonstration("d1", content="other")])
    assert lake.demonstrations() == [demonstration("d1")]


def test_demonstrations_are_asked_for_by_task(lake: Lake) -> None:
    kitting, towers = demonstration("k", "kitting"), demonstration("t", "towers")
    lake.add_all([kitting, towers])
    assert lake.demonstrations("towers") == [towers]
    assert lake.demonstrations("hanoi") == []


def test_the_long_table_holds_what_is_executed_and_achieved_in_every_frame(lake: Lake) -> None:
    lake.add(demonstration())
    rows = Table(lake.root / "actions", lake._actions.schema, ()).read(filters=[("type", "=", "drop")]).to_pylist()
    drop = demonstration().actions[1]
    by_frame = {row["frame"]: row for row in rows}
    assert set(by_frame) == {"base", "A", "box"}
    expected = drop.objects["box"].inverse() @ drop.end_effector
    executed = [by_frame["box"]["end_effector_in_frame"][name] for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    assert executed == pytest.approx([*expected.position, *expected.quaternion_xyzw])
    assert by_frame["base"]["end_effector_in_frame"]["x"] == drop.end_effector.position[0]
    assert by_frame["box"]["rest_in_frame"]["y"] == 0.01
    assert [by_frame[frame]["candidate"] for frame in ("base", "A", "box")] == [None, None, 0]


def test_an_ingest_that_was_interrupted_between_its_tables_is_not_seen_and_completes(
    lake: Lake, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(rows: pa.Table, marks: dict[str, int]) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(lake._demonstrations, "append", killed)
        with pytest.raises(KeyboardInterrupt):
            lake.add(demonstration())
    assert lake.demonstrations() == []
    other = demonstration(content="other")
    assert lake.add(other)
    assert lake.demonstrations() == [other]
    assert lake.entry("d1").demonstration == other


def test_racing_writers_ingest_everything_once(lake: Lake) -> None:
    wanted = [demonstration(f"d{number}") for number in range(6)]

    def ingest(demonstrations: Sequence[Demonstration]) -> int:
        return sum(Lake(lake.root).add(each) for each in demonstrations)

    with ThreadPoolExecutor(4) as pool:
        new = sum(pool.map(ingest, [wanted, wanted[::-1], wanted[3:] + wanted[:3], wanted[::2]]))
    assert new == len(wanted)
    assert lake.demonstrations() == wanted


def test_of_racing_writers_of_one_id_one_wins_and_the_others_conflict(lake: Lake) -> None:
    rivals = [demonstration("d1", content=str(number)) for number in range(4)]

    def ingest(rival: Demonstration) -> bool:
        try:
            return Lake(lake.root).add(rival)
        except ConflictError:
            return False

    with ThreadPoolExecutor(4) as pool:
        won = list(pool.map(ingest, rivals))
    assert won.count(True) == 1
    assert lake.demonstrations() == [rivals[won.index(True)]]


def test_an_excluded_demonstration_is_left_out_until_restored(lake: Lake) -> None:
    lake.add_all([demonstration("d1"), demonstration("d2")])
    assert lake.exclude("d1")
    assert not lake.exclude("d1")
    assert lake.demonstrations() == [demonstration("d2")]
    assert lake.demonstrations(include_excluded=True) == [demonstration("d1"), demonstration("d2")]
    assert lake.entry("d1").excluded
    assert lake.restore("d1")
    assert not lake.restore("d1")
    assert lake.demonstrations() == [demonstration("d1"), demonstration("d2")]


def test_a_relabelled_action_has_its_new_type_and_the_original_is_kept(lake: Lake) -> None:
    lake.add(demonstration())
    assert lake.relabel("d1", 2, "place")
    assert not lake.relabel("d1", 2, "place")
    entry = lake.entry("d1")
    assert [action.type for action in entry.demonstration.actions] == ["pick", "place"]
    assert entry.demonstrated_types == {2: "drop"}
    assert lake.demonstrations() == [entry.demonstration]
    assert lake.relabel("d1", 2, "drop")
    assert lake.entry("d1").demonstrated_types == {}
    (confirmed,) = lake.demonstrations()
    assert [(action.type, action.relabelled) for action in confirmed.actions] == [("pick", False), ("drop", True)]


def test_actions_that_are_taken_back_do_not_count_and_are_told(lake: Lake) -> None:
    once = demonstration()
    pick, drop = once.actions
    lake.add(replace(once, actions=(pick, drop, replace(pick, step=3), replace(drop, step=4))))
    with pytest.raises(RelabelRefusedError, match="step 3 of d1 would be a pick of A while A is held"):
        lake.undo("d1", [2])
    with pytest.raises(NotStoredError, match="'7'; stored: 1, 2, 3, 4"):
        lake.undo("d1", [1, 7])
    assert lake.undo("d1", [2, 1])
    assert not lake.undo("d1", [1])
    entry = lake.entry("d1")
    assert [action.step for action in entry.demonstration.actions] == [3, 4]
    assert entry.taken_back == (1, 2)
    with pytest.raises(RelabelRefusedError, match="nothing of d1 would be left"):
        lake.undo("d1", [3, 4])
    assert lake.exclude("d1")
    assert lake.entry("d1").excluded
    assert lake.undo("d1", [4])
    assert lake.entry("d1").excluded


def test_corrections_that_cannot_be_are_refused_and_named(lake: Lake) -> None:
    lake.add(demonstration())
    with pytest.raises(NotStoredError, match="'nobody'; stored: d1"):
        lake.exclude("nobody")
    with pytest.raises(NotStoredError, match="'7'; stored: 1, 2"):
        lake.relabel("d1", 7, "place")
    with pytest.raises(RelabelRefusedError, match="step 1 of d1 is a pick"):
        lake.relabel("d1", 1, "place")
    with pytest.raises(RelabelRefusedError, match="'push'"):
        lake.relabel("d1", 2, "push")  # type: ignore[arg-type]


def test_racing_corrections_are_all_kept(lake: Lake) -> None:
    names = [f"d{number}" for number in range(5)]
    lake.add_all([demonstration(name) for name in names])
    with ThreadPoolExecutor(5) as pool:
        assert all(pool.map(lambda name: Lake(lake.root).exclude(name), names))
    assert lake.demonstrations() == []
    assert sorted(lake._corrections.read(["serial"])["serial"].to_pylist()) == [1, 2, 3, 4, 5]


def test_a_quarantined_recording_is_listed_once_with_its_newest_reason(lake: Lake) -> None:
    assert lake.quarantine("a.mcap", "1" * 64, "torn")
    assert not lake.quarantine("a.mcap", "1" * 64, "torn")
    assert lake.quarantine("b.mcap", None, "cannot be read")
    assert lake.quarantine("a.mcap", "2" * 64, "no metadata record")
    listed = [(record.file, record.sha256, record.reason) for record in lake.quarantined()]
    assert listed == [("b.mcap", None, "cannot be read"), ("a.mcap", "2" * 64, "no metadata record")]


def test_a_recording_that_was_repaired_and_ingested_is_no_longer_quarantined(lake: Lake) -> None:
    good = demonstration()
    lake.quarantine("a.mcap", "1" * 64, "torn")
    lake.quarantine("copy.mcap", good.sha256, "disk was full")
    lake.add(good, files=["a.mcap"])
    assert lake.quarantined() == []
    assert lake.known() == {good.sha256: "d1"}
    lake.quarantine("a.mcap", "3" * 64, "overwritten")
    assert [record.reason for record in lake.quarantined()] == ["overwritten"]


def test_many_small_ingests_are_compacted_and_nothing_is_lost(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("storage.table.FILES_BEFORE_COMPACTION", 6)
    wanted = [demonstration(f"d{number:03}") for number in range(10)]
    for each in wanted:
        lake.add(each)
    assert len(lake._actions.files()) < len(wanted)
    assert lake.demonstrations() == wanted
    assert not lake.add(wanted[0])


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(StorageUnavailableError, match="lake"):
        Lake(tmp_path / "lake").add(demonstration())


def test_a_lake_below_a_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageUnavailableError, match="file/lake/actions cannot be used"):
        Lake(tmp_path / "file" / "lake").add(demonstration())


def test_a_lake_whose_log_is_damaged_is_named(lake: Lake) -> None:
    lake.add(demonstration())
    for entry in (lake.root / "demonstrations" / "_delta_log").glob("*.json"):
        entry.write_text("{torn")
    with pytest.raises(StorageUnavailableError, match="demonstrations cannot be used"):
        lake.demonstrations()
