"""A process that is kept: told of when it is down and up again, and started again however it failed."""

from __future__ import annotations

import os
import queue
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from pipelines.service.child import Child
from pipelines.service.keeper import Keeper

SLEEP = "import time; time.sleep(600)"


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipelines.service.keeper.LOOK_S", 0.02)
    monkeypatch.setattr("pipelines.service.keeper.PAUSES_S", (0.0, 0.05))
    monkeypatch.setattr("pipelines.service.keeper.SILENT_S", 0.1)
    monkeypatch.setattr("pipelines.service.keeper.HOPELESS_S", 0.5)


class Kept:
    """A keeper of scripts, the last of which is run again and again, and what it told."""

    def __init__(self, tmp_path: Path, *scripts: str, ready: Callable[[Child], bool] = lambda _: True) -> None:
        self.scripts, self.tmp_path = list(scripts), tmp_path
        self.children: list[Child] = []
        self.told: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        self.keeper = Keeper(self._make, ready, self.told.put, start_s=60.0)

    def _make(self) -> Child:
        script = self.scripts.pop(0) if len(self.scripts) > 1 else self.scripts[0]
        words = [sys.executable, "-c", script] if script else [str(self.tmp_path / "nothing here")]
        self.children.append(Child("oven", words, os.environ, self.tmp_path / "oven.log"))
        return self.children[-1]

    def hears(self) -> Mapping[str, Any]:
        return self.told.get(timeout=30)


def test_one_that_ended_is_told_of_and_started_again(tmp_path: Path) -> None:
    kept = Kept(tmp_path, "import sys; sys.exit('too hot')", SLEEP)
    with kept.keeper:
        down = kept.hears()
        assert (down["event"], down["what"]) == ("down", "oven")
        assert "the oven ended with exit code 1: too hot" in down["reason"]
        assert kept.hears() == {"event": "up", "what": "oven"}
        assert kept.keeper.up
    assert kept.children[-1].code is not None


def test_one_that_stops_answering_is_told_of_and_in_the_end_replaced(tmp_path: Path) -> None:
    answering = threading.Event()
    answering.set()
    kept = Kept(tmp_path, SLEEP, ready=lambda child: answering.is_set() or child is not kept.children[0])
    with kept.keeper:
        assert kept.keeper.wait(threading.Event())
        answering.clear()
        assert "does not answer" in kept.hears()["reason"]
        assert "has not answered for" in kept.hears()["reason"]
        assert kept.hears()["event"] == "up"
    assert len(kept.children) == 2


def test_one_that_cannot_be_started_at_all_holds_nothing_up(tmp_path: Path) -> None:
    kept = Kept(tmp_path, "", SLEEP)
    with kept.keeper:
        assert "could not be kept: FileNotFoundError" in kept.hears()["reason"]
        assert kept.hears()["event"] == "up"


def test_who_waits_for_the_first_start_is_told_how_it_went_or_stops(tmp_path: Path) -> None:
    with Kept(tmp_path, "import sys; sys.exit(1)", ready=lambda _: False).keeper as keeper:
        assert keeper.wait(threading.Event()) is False
    stop = threading.Event()
    stop.set()
    with Kept(tmp_path, SLEEP, ready=lambda _: False).keeper as keeper:
        assert keeper.wait(stop) is False
