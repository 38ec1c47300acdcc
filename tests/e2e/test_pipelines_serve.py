"""`treewright serve` with a real Prefect server: new recordings are found, learned and served by themselves."""

from __future__ import annotations

import json
import signal
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from support_processes import Daemon, command, daemon, processes_of, wait_until
from support_recordings import object_in_box

from pipelines.home import Home
from storage.lake import Lake

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(600)]
TASK = "object_in_box"


@dataclass
class Served:
    """A service that is up: its data root, its process, and where it serves."""

    home: Home
    process: Daemon
    serving: dict[str, Any]

    def get(self, path: str) -> Any:
        with urllib.request.urlopen(f"{self.serving['http']}{path}", timeout=30) as response:
            return json.loads(response.read())

    def ask_prefect(self, path: str, document: dict[str, Any]) -> Any:
        request = urllib.request.Request(
            f"{self.serving['prefect']}{path}", json.dumps(document).encode(), {"Content-Type": "application/json"}
        )
        with urllib.request.urlopen(request, timeout=30) as response:
            return json.loads(response.read())


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    home = Home(tmp_path_factory.mktemp("serve"))
    for seed in range(3):
        object_in_box(seed).write(home.recordings / "bench" / f"{seed}.mcap")
    object_in_box(9).saying(contract="8").write(home.recordings / "bench" / "bad.mcap")
    options = ("--http", "127.0.0.1:0", "--prefect-port", "0", "--period", "3", "--listen", "tcp/127.0.0.1:0")
    with daemon(home.root, "serve", *options) as process:
        assert process.hear(300) == {"ready": True}
        yield Served(home, process, process.hear(30))


def test_new_recordings_are_ingested_and_learned_on_schedule(served: Served) -> None:
    assert served.serving["event"] == "serving"
    published = served.process.hear(180)
    assert (published["event"], published["task"], published["version"]) == ("published", TASK, 1)
    latest = served.process.hear(30)
    assert (latest["event"], latest["alias"], latest["version"]) == ("alias", "latest", 1)
    (row,) = served.get("/v1/tasks")
    assert (row["task"], row["version"], row["aliases"]) == (TASK, 1, {"latest": 1})
    assert served.get(f"/v1/tasks/{TASK}/latest")["digest"] == published["digest"]


def test_a_task_is_learned_again_when_its_demonstrations_change(served: Served) -> None:
    object_in_box(4).write(served.home.recordings / "bench" / "4.mcap")
    published = served.process.hear(180)
    assert (published["event"], published["version"]) == ("published", 2)
    lineage = served.get(f"/v1/tasks/{TASK}/2")["lineage"]
    assert len(lineage["demonstrations"]) == 4


def test_what_breaks_the_contract_is_quarantined_once(served: Served) -> None:
    (refused,) = Lake(served.home.lake).quarantined()
    assert "version '8' of the contract" in refused.reason


def test_prefect_shows_tree_clusters_groups_and_quarantine(served: Served) -> None:
    artifacts = served.ask_prefect("/artifacts/latest/filter", {})
    kinds = {artifact["key"]: artifact["type"] for artifact in artifacts}
    assert kinds["quarantine"] == kinds[f"clusters-{TASK.replace('_', '-')}"] == "table"
    assert kinds[f"groups-{TASK.replace('_', '-')}"] == "table"
    assert kinds[f"tree-{TASK.replace('_', '-')}"] == "image"
    quarantine = next(artifact for artifact in artifacts if artifact["key"] == "quarantine")
    assert "version '8' of the contract" in quarantine["data"]


def test_learn_runs_the_flow_where_a_prefect_server_is_configured(served: Served) -> None:
    done = command(served.home.root, "learn", TASK, "--json", PREFECT_API_URL=served.serving["prefect"])
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["version"] == 2
    runs = served.ask_prefect("/flow_runs/filter", {"flows": {"name": {"any_": ["learn"]}}})
    assert [run["state_type"] for run in runs if run["parent_task_run_id"] is None] == ["COMPLETED"]


def test_a_refused_lesson_stays_one_line_where_the_flow_runs(served: Served) -> None:
    done = command(served.home.root, "learn", "kitting", PREFECT_API_URL=served.serving["prefect"])
    assert done.returncode == 1
    assert done.stderr == f"treewright: no demonstration of the task kitting; there are demonstrations of {TASK}\n"


def test_it_ends_cleanly_with_all_that_it_started(served: Served) -> None:
    assert processes_of(served.home.root)
    assert served.process.end(signal.SIGINT) == 0
    assert (served.home.root / "serve.stderr").read_text() == ""
    wait_until(lambda: processes_of(served.home.root) == [], 10)


def test_learn_says_so_where_the_configured_server_does_not_answer(tmp_path: Path) -> None:
    done = command(tmp_path, "learn", TASK, PREFECT_API_URL="http://127.0.0.1:9/api")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "no Prefect server answers at http://127.0.0.1:9/api" in line
