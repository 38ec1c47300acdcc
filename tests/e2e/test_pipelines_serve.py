"""`treewright serve` with a real Prefect server: recordings are found or told of, learned and served by themselves."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from support_processes import Daemon, command, daemon, processes_by_id, processes_of, wait_until
from support_recordings import object_in_box

from pipelines.home import Home
from pipelines.network.session import open_session
from pipelines.service.prefect_server import deployment_name, run_refresh
from storage.lake import Lake

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(600)]
TASK = "object_in_box"
BUSY = 503
"""What a server on SQLite answers while another writes: ask again."""
STAGES = ["choose", "cluster", "infer", "plan", "rehearse", "prove", "replay", "publish"]
NOWHERE = "http://127.0.0.1:9"
PROXIES = dict.fromkeys(("HTTP_PROXY", "http_proxy", "HTTPS_PROXY", "https_proxy", "ALL_PROXY"), NOWHERE)
"""Nothing on this machine is asked through them."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Served:
    """A service that is up: its data root, its process, and where it serves."""

    home: Home
    process: Daemon
    serving: dict[str, Any]
    endpoint: str

    def get(self, path: str) -> Any:
        with urllib.request.urlopen(f"{self.serving['http']}{path}", timeout=30) as response:
            return json.loads(response.read())

    def hear(self, event: str) -> dict[str, Any]:
        """The next of these events; others before it are passed over."""
        while (told := self.process.hear(120))["event"] != event:
            pass
        return told

    def tell(self, file: Path) -> None:
        """What a recorder says when a recording is finished, among what anybody may say."""
        network = argparse.Namespace(connect=[self.endpoint], listen=None, zenoh_config=None)
        with open_session(network, {}) as session:
            told = ({"event": "stop", "file": each} for each in ("/etc/passwd", 7, "\0", str(file)))
            for document in ("nothing", {"event": "stop"}, *told):
                session.put("treewright/bench/recorder/events", json.dumps(document))

    def kill(self, words: str) -> None:
        """End a process of the service as a crash does."""
        ids = [number for number, line in processes_by_id(self.home.root).items() if words in line]
        assert ids
        for number in ids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)

    def ask_prefect(self, path: str, document: dict[str, Any]) -> Any:
        request = urllib.request.Request(
            f"{self.serving['prefect']}{path}", json.dumps(document).encode(), {"Content-Type": "application/json"}
        )
        try:
            with urllib.request.urlopen(request, timeout=30) as response:
                return json.loads(response.read() or b"null")
        except urllib.error.HTTPError as error:
            if error.code != BUSY:
                raise
            time.sleep(1.0)
            return self.ask_prefect(path, document)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    home = Home(tmp_path_factory.mktemp("serve"))
    for seed in range(3):
        object_in_box(seed).write(home.recordings / "bench" / f"{seed}.mcap")
    object_in_box(9).saying(contract="8").write(home.recordings / "bench" / "bad.mcap")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    options = ("--http", "127.0.0.1:0", "--prefect-port", "0", "--period", "3600", "--listen", endpoint)
    with daemon(home.root, "serve", *options, **PROXIES) as process:
        assert process.hear(300) == {"ready": True}
        yield Served(home, process, process.hear(30), endpoint)


def test_recordings_that_are_there_are_ingested_and_learned(served: Served) -> None:
    assert served.serving["event"] == "serving"
    published = served.process.hear(180)
    assert (published["event"], published["task"], published["version"]) == ("published", TASK, 1)
    latest = served.process.hear(30)
    assert (latest["event"], latest["alias"], latest["version"]) == ("alias", "latest", 1)
    (row,) = served.get("/v1/tasks")
    assert (row["task"], row["version"], row["aliases"]) == (TASK, 1, {"latest": 1})
    assert served.get(f"/v1/tasks/{TASK}/latest")["digest"] == published["digest"]


def test_a_recording_that_a_recorder_finished_is_learned_from_at_once(served: Served) -> None:
    served.tell(object_in_box(4).write(served.home.recordings / "bench" / "4.mcap"))
    published = served.process.hear(180)
    assert (published["event"], published["version"]) == ("published", 2)
    lineage = served.get(f"/v1/tasks/{TASK}/2")["lineage"]
    assert len(lineage["demonstrations"]) == 4


def test_what_breaks_the_contract_is_quarantined_once(served: Served) -> None:
    (refused,) = Lake(served.home.lake).quarantined()
    assert "version '8' of the contract" in refused.reason


def test_prefect_shows_clusters_goals_tree_timings_and_quarantine(served: Served) -> None:
    def artifacts() -> dict[str, dict[str, Any]]:
        found = served.ask_prefect("/artifacts/latest/filter", {})
        return {artifact["key"].removesuffix("-object-in-box"): artifact for artifact in found}

    wait_until(lambda: {"quarantine", "clusters", "targets", "goals", "tree", "timings"} <= artifacts().keys())
    shown = artifacts()
    assert "version '8' of the contract" in shown["quarantine"]["data"]
    assert "bad.mcap](file:///" in shown["quarantine"]["data"]
    assert shown["clusters"]["data"].startswith("data:image/svg+xml,%3Csvg")
    assert "Drop A box" in shown["tree"]["data"]
    assert f"{served.serving['http']}/v1/tasks/{TASK}/" in shown["tree"]["data"]
    assert [row["stage"] for row in json.loads(shown["timings"]["data"])] == STAGES


def test_prefect_shows_each_stage_as_a_task_that_says_what_came_out(served: Served) -> None:
    (first, *_) = served.ask_prefect("/flow_runs/filter", {"flows": {"name": {"any_": ["learn"]}}})
    assert first["name"] == f"learn {TASK}"
    tags = {f"task:{TASK}", "cell:bench", "user:u1"}
    wait_until(
        lambda: (
            tags
            <= set(served.ask_prefect("/flow_runs/filter", {"flow_runs": {"id": {"any_": [first["id"]]}}})[0]["tags"])
        )
    )
    of_run = {"flow_runs": {"id": {"any_": [first["id"]]}}}
    wait_until(lambda: len(served.ask_prefect("/task_runs/filter", of_run)) >= len(STAGES))
    tasks = {run["name"].rsplit("-", 1)[0]: run for run in served.ask_prefect("/task_runs/filter", of_run)}
    assert tasks.keys() == set(STAGES)
    words = ("demonstrations of 1 user", "in the frame box", "1 group", "a tree of", "rollouts", "proven", TASK)
    wait_until(lambda: all(each in logged(served, first["id"]) for each in words))  # logs are sent by and by


def logged(served: Served, flow_run_id: str) -> str:
    logs = served.ask_prefect("/logs/filter", {"logs": {"flow_run_id": {"any_": [flow_run_id]}}})
    return "\n".join(log["message"] for log in logs)


def test_learn_runs_the_flow_where_a_prefect_server_is_configured(served: Served) -> None:
    done = command(served.home.root, "learn", TASK, "--json", PREFECT_API_URL=served.serving["prefect"])
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["version"] == 2
    runs = served.ask_prefect("/flow_runs/filter", {"flows": {"name": {"any_": ["learn"]}}})
    assert [run["state_type"] for run in runs] == ["COMPLETED"] * 3


def test_a_refused_lesson_stays_one_line_where_the_flow_runs(served: Served) -> None:
    done = command(served.home.root, "learn", "kitting", PREFECT_API_URL=served.serving["prefect"])
    assert done.returncode == 1
    assert done.stderr == f"treewright: no demonstration of the task kitting; there are demonstrations of {TASK}\n"


def test_a_prefect_server_that_dies_takes_nothing_with_it_and_is_brought_back(served: Served) -> None:
    served.kill("prefect server start")
    assert served.hear("down")["what"] == "Prefect server"
    served.tell(object_in_box(5).write(served.home.recordings / "bench" / "5.mcap"))
    told = [served.process.hear(120) for _ in range(3)]
    assert {event["event"] for event in told} == {"published", "alias", "up"}
    run_refresh(served.home, served.serving["prefect"], 120)


def test_flows_that_die_are_started_again_and_leave_no_deployment_of_what_is_no_more(served: Served) -> None:
    ours = served.ask_prefect("/deployments/filter", {})
    assert [each["name"] for each in ours] == [deployment_name(served.home)] * 3
    renamed = {"name": "line-renamed", "flow_id": ours[0]["flow_id"], "parameters": {"root": "/renamed/since"}}
    served.ask_prefect("/deployments/", renamed)
    schedule = [{"active": True, "schedule": {"interval": 3600.0}}]
    served.ask_prefect(f"/deployments/{ours[0]['id']}/schedules", schedule)
    served.kill("pipelines.flows.process")
    assert served.hear("down")["what"] == served.hear("up")["what"] == "process of the flows"

    def left() -> list[tuple[str, int]]:
        return [(each["name"], len(each["schedules"])) for each in served.ask_prefect("/deployments/filter", {})]

    wait_until(lambda: left() == [(deployment_name(served.home), 0)] * 3)


def test_it_ends_cleanly_with_all_that_it_started(served: Served) -> None:
    assert processes_of(served.home.root)
    assert served.process.end(signal.SIGINT) == 0
    told = (served.home.root / "serve.stderr").read_text().splitlines()
    assert [line.split(" ended ")[0] for line in told] == [
        "treewright: the Prefect server",
        "treewright: the process of the flows",
    ]
    wait_until(lambda: processes_of(served.home.root) == [], 10)


def test_learn_says_so_where_the_configured_server_does_not_answer(tmp_path: Path) -> None:
    done = command(tmp_path, "learn", TASK, PREFECT_API_URL="http://127.0.0.1:9/api")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "no Prefect server answers at http://127.0.0.1:9/api" in line
