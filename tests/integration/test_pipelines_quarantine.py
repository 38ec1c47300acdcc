"""A demonstration in quarantine is shown, relabelled and cut, and judged again; nothing of it is ever lost."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from support_recordings import Take, object_in_box

from pipelines.cli import main
from pipelines.home import Home
from storage.lake import Lake

ID = "object_in_box-1"
Run = Callable[..., Any]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    monkeypatch.setenv("TREEWRIGHT_HOME", str(tmp_path / "home"))
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    return Home.current()


@pytest.fixture
def run(home: Home, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command with --json; its document, or of a failure its line."""

    def call(*words: str, code: int = 0) -> Any:
        capsys.readouterr()
        assert main([*words, "--json"]) == code
        said = capsys.readouterr()
        return json.loads(said.out) if code == 0 else said.err

    return call


def pressed_twice(seed: int = 1) -> Take:
    """Between pick and drop the pick was pressed once more."""
    pick, drop = (take := object_in_box(seed)).presses()
    return take.with_presses([pick, {**pick, "stamp_ns": pick["stamp_ns"] + 200_000_000}, drop])


def of_type(*types: str) -> Take:
    presses = (take := object_in_box(1)).presses()
    return take.with_presses([{**press, "type": type_} for press, type_ in zip(presses, types, strict=True)])


def refused(file: Path, take: Take) -> bytes:
    content = take.write(file).read_bytes()
    assert main(["ingest", str(file)]) == 1
    return content


def judged(document: dict[str, Any]) -> Sequence[tuple[int, str, str]]:
    return [(action["step"], action["type"], action["verdict"]) for action in document["actions"]]


def test_what_contradicts_is_shown_taken_back_and_then_learned_from(home: Home, run: Run) -> None:
    for seed in (1, 2, 3):
        file = home.recordings / f"{seed}.mcap"
        content = refused(file, pressed_twice(seed))
        name = f"object_in_box-{seed}"
        shown = run("demos", "show", name)
        assert "picks while A is held" in shown["quarantined"]
        assert judged(shown) == [(0, "pick", "accepted"), (1, "pick", "contradicts"), (2, "drop", "accepted")]
        assert "picks while A is held" in shown["actions"][1]["reason"]
        undone = run("demos", "undo", name, "1")
        assert undone == {"demonstration_id": name, "taken_back": [1], "changed": True, "quarantined": None}
        shown = run("demos", "show", name)
        assert [(action["step"], action["type"]) for action in shown["actions"]] == [(0, "pick"), (2, "drop")]
        assert shown["taken_back"] == [1]
        assert shown["warnings"] == ["action 1 (pick) was afterwards taken back"]
        assert file.read_bytes() == content, "the recording is never changed"
        assert run("ingest", str(file)) == {"ingested": [], "known": [name], "quarantined": []}
    assert run("demos", "list")["quarantined"] == []
    assert run("learn", "object_in_box")["nodes"] == 12


def test_a_type_that_was_not_meant_is_corrected(home: Home, run: Run) -> None:
    refused(home.recordings / "1.mcap", of_type("pick", "pick"))
    document = run("relabel", ID, "1", "drop")
    expected = {"step": 1, "type": "drop", "demonstrated_type": "pick", "changed": True, "quarantined": None}
    assert document == {"demonstration_id": ID, **expected}
    (_, drop) = run("demos", "show", ID)["actions"]
    assert (drop["type"], drop["object"]) == ("drop", "A")
    assert Lake(home.lake).demonstrations()[0].actions[1].relabelled
    run("relabel", ID, "1", "place")
    assert run("demos", "show", ID)["actions"][1]["type"] == "place"


def test_a_demonstration_stays_in_quarantine_until_nothing_contradicts(home: Home, run: Run) -> None:
    refused(home.recordings / "1.mcap", of_type("drop", "pick"))
    assert "picks while A is held" in run("relabel", ID, "0", "pick")["quarantined"]
    shown = run("demos", "show", ID)
    assert [(action["type"], action["demonstrated_type"]) for action in shown["actions"]] == [
        ("pick", "drop"),
        ("pick", "pick"),
    ]
    assert run("ingest", str(home.recordings / "1.mcap"), code=1).count("picks while A is held") == 1
    assert run("relabel", ID, "1", "drop")["quarantined"] is None


def test_what_was_taken_back_returns_with_a_type(home: Home, run: Run) -> None:
    refused(home.recordings / "1.mcap", of_type("drop", "drop"))
    assert "releases A, but nothing is held" in run("demos", "undo", ID, "0")["quarantined"]
    assert run("demos", "show", ID)["taken_back"] == [0]
    assert run("relabel", ID, "0", "pick")["quarantined"] is None
    assert [action["type"] for action in run("demos", "show", ID)["actions"]] == ["pick", "drop"]


def test_a_copy_is_corrected_where_the_recording_is_gone(home: Home, run: Run, tmp_path: Path) -> None:
    file = tmp_path / "elsewhere" / "1.mcap"
    refused(file, pressed_twice())
    file.unlink()
    assert run("demos", "show", ID)["files"] == [str(next(home.quarantine.iterdir()))]
    assert run("demos", "undo", ID, "1")["quarantined"] is None
    assert run("demos", "list")["quarantined"] == []


def test_a_split_demonstration_is_corrected_as_one(home: Home, run: Run) -> None:
    for number, part in enumerate(pressed_twice().halves(), start=1):
        part.write(home.recordings / f"1-{number}.mcap")
    assert main(["ingest"]) == 1
    assert len(run("demos", "show", ID)["files"]) == 2
    assert run("demos", "undo", ID, "1")["quarantined"] is None
    assert run("demos", "list")["quarantined"] == []


def test_a_step_that_is_none_and_an_id_that_is_none_are_told(home: Home, run: Run) -> None:
    refused(home.recordings / "1.mcap", pressed_twice())
    assert "no step of object_in_box-1 '9'; stored: 0, 1, 2" in run("demos", "undo", ID, "9", code=1)
    assert "no step of object_in_box-1 '9'" in run("relabel", ID, "9", "drop", code=1)
    assert "no demonstration 'other'" in run("demos", "undo", "other", "1", code=1)
    assert "no demonstration 'other'" in run("demos", "show", "other", code=1)


def test_of_what_is_learned_from_a_pick_and_its_release_are_taken_back_together(home: Home, run: Run) -> None:
    object_in_box(1).write(home.recordings / "1.mcap")
    run("ingest")
    assert "would be a drop of A while nothing is held" in run("demos", "undo", ID, "0", code=1)
    assert "nothing of object_in_box-1 would be left" in run("demos", "undo", ID, "0", "1", code=1)
    assert run("demos", "undo", ID, "1") == {
        "demonstration_id": ID,
        "taken_back": [1],
        "changed": True,
        "quarantined": None,
    }
    assert run("demos", "undo", ID, "1")["changed"] is False
    assert [action["step"] for action in run("demos", "show", ID)["actions"]] == [0]
