"""What the scheduled refresh learns: only tasks of which something changed since."""

from __future__ import annotations

from pathlib import Path

import pytest
from support_recordings import object_in_box

from pipelines.home import Home
from pipelines.steps.changes import changed_tasks, remember, standings
from pipelines.steps.ingest import ingest
from storage.lake import Lake


@pytest.fixture
def home(tmp_path: Path) -> Home:
    return Home(tmp_path)


def show(home: Home, task: str, *seeds: int) -> Lake:
    lake = Lake(home.lake)
    files = [object_in_box(seed, task).write(home.recordings / f"{task}-{seed}.mcap") for seed in seeds]
    assert len(ingest(home, lake, files).ingested) == len(seeds)
    return lake


def settle(home: Home, lake: Lake) -> None:
    """Remember every task as learned, as it stands."""
    for task, standing in changed_tasks(home, lake).items():
        remember(home, task, standing.with_result("version 1"))


def test_every_task_is_learned_at_first_and_none_that_is_remembered(home: Home) -> None:
    show(home, "kitting", 1)
    lake = show(home, "towers", 1)
    assert list(changed_tasks(home, lake)) == ["kitting", "towers"]
    settle(home, lake)
    assert changed_tasks(home, lake) == {}
    assert {task: standing.result for task, standing in standings(home).items()} == {
        "kitting": "version 1",
        "towers": "version 1",
    }


def test_a_new_demonstration_changes_its_task_alone(home: Home) -> None:
    show(home, "kitting", 1)
    lake = show(home, "towers", 1)
    settle(home, lake)
    show(home, "towers", 2)
    assert list(changed_tasks(home, lake)) == ["towers"]


def test_a_persons_correction_changes_the_task_and_taking_it_back_restores_it(home: Home) -> None:
    lake = show(home, "kitting", 1, 2)
    settle(home, lake)
    lake.exclude("kitting-1")
    assert list(changed_tasks(home, lake)) == ["kitting"]
    lake.restore("kitting-1")
    assert changed_tasks(home, lake) == {}
    lake.relabel("kitting-2", 1, "place")
    assert list(changed_tasks(home, lake)) == ["kitting"]


def test_a_memory_that_is_damaged_means_learning_again(home: Home) -> None:
    lake = show(home, "kitting", 1)
    settle(home, lake)
    home.learned.write_text("{ torn")
    assert list(changed_tasks(home, lake)) == ["kitting"]


def test_an_empty_lake_has_nothing_to_learn(home: Home) -> None:
    assert changed_tasks(home, Lake(home.lake)) == {}
