"""The demo, whole: a Prefect server, a simulated cell, a recorder and a controller, each a process of its own."""

from __future__ import annotations

import json
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from support_processes import processes_of, wait_until

from pipelines.commands import demo as command
from pipelines.console import Console
from pipelines.demo.demo import Report, Run
from recorder.recording import read_recording
from storage.artifacts import ArtifactStore
from storage.btcpp import from_xml

pytestmark = pytest.mark.e2e
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("demo") / "home"


@pytest.fixture(scope="module")
def report(folder: Path) -> dict[str, Any]:
    """What `treewright demo --json` prints; it exited with 0."""
    words = [sys.executable, "-m", "pipelines.cli", "demo", "--json", "--home", str(folder)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr + "".join(file.read_text() for file in (folder / "logs").glob("*.log"))
    assert done.stderr == ""
    document: dict[str, Any] = json.loads(done.stdout)
    return document


@pytest.mark.timeout(600)
def test_the_robot_does_what_it_was_shown_by_the_truth_of_the_world(report: dict[str, Any]) -> None:
    assert report["success"] is True
    assert [(run["name"], run["success"]) for run in report["runs"]] == [
        ("from a new start", True),
        ("disturbed", True),
    ]
    assert report["runs"][0]["actions"] >= 2
    assert len(report["runs"][1]["disturbances"]) == 2
    assert report["runs"][1]["actions"] > 2
    assert 2 <= report["tree"]["nodes"] <= 12


def test_each_file_is_where_the_report_says(report: dict[str, Any]) -> None:
    files = report["files"]
    recordings = [read_recording([Path(file)]) for file in files["recordings"]]
    assert [recording.outcome for recording in recordings] == ["success"] * 3
    assert "<svg" in Path(files["picture"]).read_text()
    with ArtifactStore(Path(files["store"])) as store:
        artifact = store.verify("object_in_box", "latest")
    assert from_xml(Path(files["xml"]).read_text()).digest == artifact.digest == report["tree"]["digest"]
    learned_from = {origin["sha256"] for origin in artifact.manifest["lineage"]["demonstrations"]}
    assert learned_from == {recording.sha256 for recording in recordings}
    for trace in files["traces"]:
        assert [json.loads(line) for line in Path(trace).read_text().splitlines()]


def test_the_flows_ran_on_the_server_and_show_what_a_person_wants_to_see(report: dict[str, Any], folder: Path) -> None:
    with sqlite3.connect(f"file:{folder / 'prefect' / 'prefect.db'}?mode=ro", uri=True) as database:
        runs = dict(database.execute(
            "select flow.name, flow_run.state_type from flow_run join flow on flow.id = flow_run.flow_id "
            "where flow_run.state_type != 'SCHEDULED'"
        ))  # fmt: skip
        shown = {key for (key,) in database.execute("select key from artifact where key is not null")}
    assert runs == {"refresh": "COMPLETED", "ingest": "COMPLETED", "learn": "COMPLETED"}
    assert {"ingested", "tree-object-in-box", "timings-object-in-box", "clusters-object-in-box"} <= shown


def test_no_process_outlives_the_demo(report: dict[str, Any], folder: Path) -> None:
    assert report
    assert processes_of(folder) == []


@pytest.mark.timeout(120)
def test_a_demo_that_is_interrupted_ends_all_that_it_started(tmp_path: Path) -> None:
    folder = tmp_path / "home"
    words = [sys.executable, "-m", "pipelines.cli", "demo", "--json", "--home", str(folder)]
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        wait_until(lambda: len(processes_of(folder)) > 3)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "")
    assert processes_of(folder) == []


def test_a_robot_that_failed_makes_the_demo_fail(capsys: pytest.CaptureFixture[str]) -> None:
    good = Run("from a new start", True, "success", None, 2, 100, 7.0, (), "/d/traces/a.jsonl")
    bad = Run("disturbed", False, "timeout", "300 s are over", 9, 900, 300.0, (), "/d/traces/b.jsonl")
    tree = {"task": "t", "version": 1, "nodes": 12, "nodes_recovery": 0, "nodes_written": 13}
    names = ("home", "lake", "store", "xml", "picture", "logs")
    files = {name: f"/d/{name}" for name in names} | {"recordings": ["/d/r/1.mcap"], "traces": ["/d/traces/a.jsonl"]}
    assert command.conclude(Report(False, 100.0, tree, (good, bad), files), Console(as_json=False)) == 1
    out, err = capsys.readouterr()
    assert "1 of 2 runs" in out
    assert len(err.splitlines()) == 1
    assert "disturbed" in err


def test_a_folder_that_no_demo_made_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    words = [sys.executable, "-m", "pipelines.cli", "demo", "--home", str(tmp_path)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "holds something that no demo made" in done.stderr
    assert (tmp_path / "thesis.txt").read_text() == "years of work"
