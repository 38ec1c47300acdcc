"""Nothing listens that was not asked to: looked up at the sockets of the processes themselves."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support_processes import command, daemon, wait_until

pytestmark = pytest.mark.e2e
LISTENING = "0A"


def listeners(pid: int) -> set[str]:
    """The TCP sockets on which a process listens and the UDP sockets that it has bound, as /proc writes them."""
    inodes = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = str(entry.readlink())
        except FileNotFoundError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = set()
    for table in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes and (table.startswith("udp") or fields[3] == LISTENING):
                found.add(f"{table} {fields[1]}")
    return found


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A recorder that listens where it was told to."""
    where = f"tcp/127.0.0.1:{free_port()}"
    root = tmp_path_factory.mktemp("listener")
    with daemon(root, "record", "--cell", "bench", "--listen", where) as process:
        process.hear(60)
        assert len(listeners(process.process.pid)) == 1
        yield where


@pytest.mark.parametrize(
    "words", [("record", "--cell", "other"), ("sim", "--cell", "bench", "--speed", "1")], ids=lambda words: words[0]
)
def test_who_only_connects_does_not_listen(words: tuple[str, ...], endpoint: str, tmp_path: Path) -> None:
    with daemon(tmp_path, *words, "--connect", endpoint) as process:
        process.hear(60)
        assert listeners(process.process.pid) == set()


def test_who_connects_reaches_the_others_through_who_listens(endpoint: str, tmp_path: Path) -> None:
    """The simulated cell's poses arrive at a recorder that it does not know; no stranger is needed for it."""
    with daemon(tmp_path / "sim", "sim", "--cell", "far", "--connect", endpoint) as sim:
        sim.hear(60)
        with daemon(tmp_path / "far", "record", "--cell", "far", "--connect", endpoint) as recorder:
            recorder.hear(60)
            words = ("--cell", "far", "--connect", endpoint, "--json")
            start = ("--task", "t", "--user", "u", "--objects", "A,box")
            started = command(tmp_path, "demonstrate", *words[:2], "start", *start, *words[2:])
            assert started.returncode == 0, started.stderr
            wait_until(lambda: "/poses" in asked(tmp_path, words)["messages"], 20)


def asked(home: Path, words: tuple[str, ...]) -> dict[str, Any]:
    done = command(home, "demonstrate", *words[:2], "status", *words[2:])
    status: dict[str, Any] = json.loads(done.stdout)
    return status
