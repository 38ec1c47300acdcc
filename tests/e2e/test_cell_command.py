"""`treewright sim` as a process of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import pytest
from support_physical_cell import free_port, open_loopback

from pipelines.network.question import ask


def sim(*options: str) -> list[str]:
    return [sys.executable, "-m", "pipelines.cli", "sim", *options]


@pytest.mark.e2e
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_says_that_it_is_ready_lives_and_ends_cleanly_when_told(number: signal.Signals) -> None:
    port = free_port()
    options = ("--cell", "c7", "--seed", "1", "--speed", "10", "--listen", f"tcp/127.0.0.1:{port}", "--json")
    with subprocess.Popen(sim(*options), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        ready = json.loads(process.stdout.readline())
        with open_loopback(port, listen=False) as session:
            reply = ask(session, "treewright/c7/skills/SetGripper", {"state": "closed", "execution_id": "e1"}, 30)
        process.send_signal(number)
        rest, complaints = process.stdout.read(), process.stderr.read()

    assert ready == {"ready": True}
    assert reply["status"] == "success"
    assert [json.loads(line)["event"] for line in rest.splitlines()] == ["shown", "skill started", "skill ended"]
    assert complaints == ""
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--cell", "../c"], "cell name '../c' is refused"),
        (["--cell", "artifacts"], "this name is reserved"),
        (["--cell", "c", "--scenario", "juggling"], "no scenario 'juggling'; there are object_in_box"),
        (["--cell", "c", "--listen", "nonsense"], "Zenoh refuses"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(options: list[str], sentence: str) -> None:
    environment = {**os.environ, "TREEWRIGHT_DEBUG": ""}
    done = subprocess.run(sim(*options), capture_output=True, text=True, env=environment, timeout=120, check=False)

    assert done.returncode == 1
    assert sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""
