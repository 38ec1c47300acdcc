"""What is recorded is ingested and learned at once, or in time, also without a Prefect server; no task waits for
another.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from support_processes import wait_until
from support_recordings import object_in_box

from pipelines.flows.dispatcher import Absence, Dispatcher
from pipelines.flows.jobs import NEEDED
from pipelines.flows.worker import preload
from pipelines.home import Home
from pipelines.steps.changes import changed_tasks, standings
from pipelines.steps.learn import learning
from storage.artifacts import ArtifactStore
from storage.lake import Lake

PERIOD_S = 1.0


@dataclass
class Floor:
    """A data root with a dispatcher that works."""

    home: Home
    dispatcher: Dispatcher

    def show(self, task: str, seed: int, told: bool = True) -> Path:
        """Record a demonstration, and tell of it."""
        hidden = object_in_box(seed, task).write(self.home.root / "hidden" / f"{task}-{seed}.mcap")
        file = self.home.recordings / "bench" / hidden.name
        file.parent.mkdir(parents=True, exist_ok=True)
        hidden.replace(file)
        if told:
            self.dispatcher.tell(file)
        return file

    def learned(self, task: str) -> Callable[[], bool]:
        """Whether a task was learned as it stands."""
        return lambda: task in standings(self.home) and task not in changed_tasks(self.home, Lake(self.home.lake))


@pytest.fixture(scope="module")
def floor(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Floor]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")
        home = Home(tmp_path_factory.mktemp("floor"))
        preload(NEEDED)
        dispatcher = Dispatcher(home, PERIOD_S, learners=2)
        dispatcher.warm_up()
        dispatcher.begin()
        thread = threading.Thread(target=dispatcher.run)
        thread.start()
        yield Floor(home, dispatcher)
        dispatcher.stop()
        thread.join(60)
        assert not thread.is_alive()


def test_what_it_is_told_of_is_learned_and_published(floor: Floor) -> None:
    floor.show("kitting", 1)
    wait_until(floor.learned("kitting"))
    with ArtifactStore(floor.home.store) as store:
        assert store.get("kitting", "latest").version == 1


def test_what_nobody_told_of_is_found_in_time(floor: Floor) -> None:
    floor.show("towers", 1, told=False)
    wait_until(floor.learned("towers"))


def test_a_slow_task_holds_up_neither_ingest_nor_another_task(floor: Floor) -> None:
    with learning(floor.home, "slow"):
        floor.show("slow", 1)
        wait_until(lambda: "slow" in changed_tasks(floor.home, Lake(floor.home.lake)))
        floor.show("quick", 1)
        wait_until(floor.learned("quick"))
        assert "slow" not in standings(floor.home)
    wait_until(floor.learned("slow"))


def test_a_demonstration_that_comes_while_its_task_is_learned_is_learned_from_next(floor: Floor) -> None:
    with learning(floor.home, "kitting"):
        floor.show("kitting", 2)
        wait_until(lambda: len(Lake(floor.home.lake).entries("kitting")) == 2)
        floor.show("kitting", 3)
        wait_until(lambda: len(Lake(floor.home.lake).entries("kitting")) == 3)
    wait_until(floor.learned("kitting"))
    with ArtifactStore(floor.home.store) as store:
        newest = store.get("kitting", max(row["version"] for row in store.versions("kitting")))
    assert len(newest.manifest["lineage"]["demonstrations"]) == 3


def test_what_is_no_recording_is_quarantined_and_stops_nothing(floor: Floor) -> None:
    bad = floor.home.recordings / "bench" / "bad.mcap"
    bad.write_bytes(b"nothing")
    floor.dispatcher.tell(bad)
    floor.dispatcher.tell(floor.home.recordings / "gone.mcap")
    wait_until(lambda: len(Lake(floor.home.lake).quarantined()) == 1)
    floor.show("last", 1)
    wait_until(floor.learned("last"))


def test_a_server_is_gone_once_it_has_not_answered_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")
    monkeypatch.setattr("pipelines.flows.dispatcher.GONE_S", 0.1)
    absence = Absence()
    assert not absence()
    time.sleep(0.2)
    assert absence()
