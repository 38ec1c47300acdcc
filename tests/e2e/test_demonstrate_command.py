"""The operator's buttons, each pressed by a process that has only just joined the network."""

from __future__ import annotations

import argparse
import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support_processes import command, daemon

from pipelines.network.session import open_session

START = ("--task", "lift", "--user", "u1", "--objects", "A", "--base-frame", "map", "--end-effector-frame", "hand",
         "--unseen-ok")  # fmt: skip


@pytest.fixture
def endpoint() -> Iterator[str]:
    """A router's, on a free port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        where = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with open_session(argparse.Namespace(connect=None, listen=[where], zenoh_config=None), {}, mode="router"):
        yield where


def test_every_button_finds_a_recorder_that_is_there(tmp_path: Path, endpoint: str) -> None:
    press = ("demonstrate", "--cell", "c1", "--json", "--connect", endpoint)
    with daemon(tmp_path, "record", "--cell", "c1", "--connect", endpoint) as recorder:
        assert recorder.hear() == {"ready": True}
        buttons = [("status",)] * 4 + [
            ("start", *START), ("pick", "A"), ("undo",), ("signal", "door", "true"), ("status",), ("stop",)
        ]  # fmt: skip
        pressed = [command(tmp_path, *press, *button) for button in buttons]
    assert [done.returncode for done in pressed] == [0] * len(buttons)
    assert [bool(done.stderr) for done in pressed] == [False] * 5 + [True, False, True, False, False]
    pick, undo, signal, status, stop = (json.loads(done.stdout) for done in pressed[-5:])
    assert (pick["verdict"], pressed[5].stderr) == ("contradicts", f"treewright: {pick['reason']}\n")
    assert (undo["step"], undo["type"], undo["object"]) == (0, "undo", "A")
    assert "sets door to true" in signal["reason"]
    assert status["actions_durable"] == 3
    assert stop["messages"] == {"/action": 3}


def test_a_recorder_that_is_not_there_is_not_waited_for_long(tmp_path: Path, endpoint: str) -> None:
    begun_s = time.monotonic()
    done = command(tmp_path, "demonstrate", "--cell", "c1", "--connect", endpoint, "status")
    assert done.returncode == 1
    assert done.stderr == (
        "treewright: no recorder answers for treewright/c1; start `treewright record` or check --connect\n"
    )
    assert time.monotonic() - begun_s < 55, "the patience of 60 s is for a recorder that is there"
