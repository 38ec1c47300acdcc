"""Many recordings: in batches, each once whatever dies, and read again only if they changed."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pyarrow.compute as pc
import pytest
from deltalake import DeltaTable
from support_killed_ingest import run_killed
from support_recordings import object_in_box

from learner.progress import heard_by
from pipelines.home import Home
from pipelines.steps import ingest as ingesting
from pipelines.steps.ingest import IngestResult, ingest
from storage.lake import Lake

TAKE = object_in_box(1)


@pytest.fixture
def home(tmp_path: Path) -> Home:
    return Home(tmp_path / "home")


def write(home: Home, name: str) -> Path:
    return TAKE.saying(demonstration_id=name).write(home.recordings / "bench" / f"{name}.mcap")


def write_damaged(home: Home, name: str) -> Path:
    file = home.recordings / "bench" / f"{name}.mcap"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(f"{name} is no recording".encode())
    return file


def ingested(home: Home, *named: Path) -> IngestResult:
    return ingest(home, Lake(home.lake), named)


def commits(home: Home, table: str) -> int:
    return DeltaTable(home.lake / table).version()


def test_an_ingest_killed_at_any_commit_is_repeated_without_double_or_hole(home: Home) -> None:
    good = [f"d{number}" for number in range(8)]
    for name in good:
        write(home, name)
    bad = [str(write_damaged(home, f"e{number}")) for number in range(4)]
    run_killed(home.root, "points", 10)
    lake = Lake(home.lake)
    found = lake.demonstrations()
    assert sorted(each.demonstration_id for each in found) == good
    assert {len(each.actions) for each in found} == {2}
    assert sorted(each.file for each in lake.quarantined()) == bad
    assert ingested(home) == IngestResult((), tuple(good), (), ())
    # Not only what is read: what lies there, for whoever reads the tables by themselves.
    actions = DeltaTable(home.lake / "actions").to_pyarrow_table()
    counted = actions.group_by(["demonstration_id", "step", "frame"]).aggregate([([], "count_all")])
    assert pc.max(counted["count_all"]).as_py() == 1
    assert DeltaTable(home.lake / "demonstrations").to_pyarrow_table().num_rows == len(good)


def test_damaged_files_cost_a_commit_a_batch(home: Home) -> None:
    for number in range(30):
        write_damaged(home, f"e{number}")
    assert len(ingested(home).quarantined) == 30
    assert commits(home, "quarantine") == 1
    assert commits(home, "files") == 1


def test_what_conflicts_with_the_lake_does_not_split_its_batch(home: Home, tmp_path: Path) -> None:
    for number in range(3):
        write(home, f"d{number}")
    ingested(home)
    rivals = [object_in_box(2, demonstration_id=f"d{n}").write(tmp_path / f"{n}.mcap") for n in range(3)]
    others = [TAKE.saying(demonstration_id=f"f{n}").write(tmp_path / f"f{n}.mcap") for n in range(3)]
    result = ingested(home, *rivals, *others)
    assert len(result.quarantined) == len(result.ingested) == 3
    assert (commits(home, "demonstrations"), commits(home, "quarantine")) == (2, 1)


def test_a_pass_is_more_than_one_batch_where_there_are_many(home: Home, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ingesting, "BATCH", 2)
    for number in range(5):
        write(home, f"d{number}")
    told: list[str] = []
    with heard_by(told.append):
        result = ingested(home)
    assert len(result.ingested) == 5
    assert commits(home, "demonstrations") == 3
    assert [words for words in told if "to the lake" in words] == [
        f"writing {count} demonstrations to the lake" for count in (2, 2, 1)
    ]


def test_known_files_are_not_read_again_whatever_they_are_known_as(
    home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, refused = write(home, "d1"), write_damaged(home, "e1")
    copy = Path(shutil.copy(file, file.with_name("copy.mcap")))
    ingested(home)
    read: list[Path] = []
    monkeypatch.setattr(ingesting, "sha256_of", lambda files: read.extend(files))
    assert ingested(home).known == ("d1",)
    assert ingested(home, file, copy).known == ("d1",)
    assert read == []
    monkeypatch.undo()
    os.utime(copy)  # as a copying program may: looked at once more, and then no more
    assert ingested(home).known == ("d1",)
    monkeypatch.setattr(ingesting, "sha256_of", lambda files: read.extend(files))
    assert ingested(home).known == ("d1",)
    assert read == []
    assert refused.exists()


def test_other_bytes_of_the_same_size_and_time_are_noticed(home: Home) -> None:
    file = write(home, "d1")
    ingested(home)
    before = file.stat()
    content = bytearray(file.read_bytes())
    content[-20] ^= 1
    file.write_bytes(content)
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert len(ingested(home).quarantined) == 1


def test_files_are_found_known_where_the_memory_of_them_is_gone(home: Home) -> None:
    write(home, "d1")
    ingested(home)
    shutil.rmtree(home.lake / "files")
    assert ingested(home) == IngestResult((), ("d1",), (), ())
    assert commits(home, "files") == 1


def test_recordings_are_ingested_anew_where_the_lake_lost_them(home: Home) -> None:
    write(home, "d1")
    ingested(home)
    for table in ("demonstrations", "actions"):
        shutil.rmtree(home.lake / table)
    assert [each.demonstration_id for each in ingested(home).ingested] == ["d1"]


def test_the_log_does_not_grow_by_a_mark_for_each_demonstration(home: Home) -> None:
    for number in range(3):
        write(home, f"d{number}")
        ingested(home)
    for table in ("demonstrations", "actions"):
        log = "".join(file.read_text() for file in sorted((home.lake / table / "_delta_log").glob("*.json")))
        assert log.count('"txn"') <= 2 * 3
        assert '"appId":"d1' not in log
