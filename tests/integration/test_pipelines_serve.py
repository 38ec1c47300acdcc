"""`treewright serve --store-only`: the artifact store on HTTP and Zenoh, its events, its end, and ports in use."""

from __future__ import annotations

import argparse
import json
import signal
import socket
import urllib.request
from pathlib import Path

import httpx
import pytest
from support_processes import command, daemon
from support_recordings import object_in_box

from pipelines.home import Home
from pipelines.network.session import open_session
from pipelines.steps.ingest import ingest
from storage.client import fetch
from storage.lake import Lake

TASK = "object_in_box"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_a_tree_that_another_process_learns_is_announced_and_served(tmp_path: Path) -> None:
    home, endpoint = Home(tmp_path), f"tcp/127.0.0.1:{free_port()}"
    files = [object_in_box(seed).write(tmp_path / f"{seed}.mcap") for seed in range(3)]
    ingest(home, Lake(home.lake), files)
    with daemon(tmp_path, "serve", "--store-only", "--http", "127.0.0.1:0", "--listen", endpoint) as process:
        assert process.hear() == {"ready": True}
        serving = process.hear()
        assert (serving["event"], serving["prefect"]) == ("serving", None)
        assert command(tmp_path, "learn", TASK).returncode == 0
        assert [process.hear()["event"] for _ in range(2)] == ["published", "alias"]
        with urllib.request.urlopen(f"{serving['http']}/v1/tasks/{TASK}/latest", timeout=30) as response:
            manifest = json.loads(response.read())
        network = argparse.Namespace(connect=[endpoint], listen=None, zenoh_config=None)
        with open_session(network, {}) as session:
            fetched = fetch(session, TASK, alias="latest", timeout_s=30)
        assert fetched.manifest == manifest
        assert process.end(signal.SIGTERM) == 0


def test_a_port_in_use_is_one_clear_sentence(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        http = command(tmp_path, "serve", "--store-only", "--http", address, "--listen", "tcp/127.0.0.1:0")
        port = address.partition(":")[2]
        options = ("--http", "127.0.0.1:0", "--prefect-port", port, "--listen", "tcp/127.0.0.1:0")
        prefect = command(tmp_path, "serve", *options)
        zenoh = command(tmp_path, "serve", "--store-only", "--http", "127.0.0.1:0", "--listen", f"tcp/{address}")
    for done in (http, prefect, zenoh):
        assert done.returncode == 1
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert port in done.stderr


def test_two_services_on_one_data_root_are_one_too_many(tmp_path: Path) -> None:
    options = ("serve", "--store-only", "--http", "127.0.0.1:0", "--listen", "tcp/127.0.0.1:0")
    with daemon(tmp_path, *options) as process:
        assert process.hear() == {"ready": True}
        second = command(tmp_path, *options)
    assert second.returncode == 1
    (line,) = second.stderr.splitlines()
    assert line.startswith(f"treewright: a service of {tmp_path} is running already: process {process.process.pid}, ")


@pytest.mark.parametrize(
    "words", [("--http", "8420"), ("--http", "a:b"), ("--prefect-port", "x"), ("--period", "0"), ("--learners", "0")]
)
def test_an_address_that_is_none_is_wrong_usage(words: tuple[str, str], tmp_path: Path) -> None:
    assert command(tmp_path, "serve", *words).returncode == 2


def test_a_prefect_server_that_does_not_answer_is_one_clear_sentence(tmp_path: Path) -> None:
    options = ("--http", "127.0.0.1:0", "--listen", "tcp/127.0.0.1:0")
    done = command(tmp_path, "serve", *options, PREFECT_API_URL="http://127.0.0.1:9/api")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "no Prefect server answers" in line


def test_the_panel_of_a_cell_is_at_the_root_beside_the_store(tmp_path: Path) -> None:
    options = ("--store-only", "--http", "127.0.0.1:0", "--listen", "tcp/127.0.0.1:0", "--cell", "c1")
    with daemon(tmp_path, "serve", *options) as process:
        assert process.hear() == {"ready": True}
        with httpx.Client(base_url=process.hear()["http"], timeout=30) as client:
            assert "Teach" in client.get("/").text
            assert client.get("/v1/tasks").json() == []
            foreign = {"Origin": "http://evil.example"}
            assert client.get("/", headers=foreign).status_code == 403
            assert client.get("/v1/tasks", headers=foreign).status_code == 200
        assert process.end(signal.SIGTERM) == 0


def test_the_panel_is_served_to_other_machines_only_for_tokens(tmp_path: Path) -> None:
    options = ("--store-only", "--http", "0.0.0.0:0", "--listen", "tcp/127.0.0.1:0", "--cell", "c1")
    done = command(tmp_path, "serve", *options)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "token add" in line
