"""Commands of treewright as processes of their own, as a person or a machine starts them."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[1]
FOREIGN: Final = ("TREEWRIGHT_", "PREFECT_")


class Daemon:
    """A long-running command with --json: what it says, one object a line."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)

    def hear(self, timeout_s: float = 120) -> dict[str, Any]:
        """The next object; fails the test if none comes."""
        try:
            document: dict[str, Any] = json.loads(self._lines.get(timeout=timeout_s))
        except queue.Empty:
            raise AssertionError(f"nothing more was said; exit code {self.process.poll()}") from None
        return document

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send a signal; the exit code."""
        self.process.send_signal(number)
        return self.process.wait(60)


def environment(home: Path, **more: str) -> dict[str, str]:
    """This process's environment with a data root, without anybody's own settings."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(FOREIGN)}
    return {**kept, "TREEWRIGHT_HOME": str(home), **more}


def command(home: Path, *words: str, **more: str) -> subprocess.CompletedProcess[str]:
    """A command run to its end."""
    line = [sys.executable, "-m", "pipelines.cli", *words]
    return subprocess.run(
        line, cwd=ROOT, env=environment(home, **more), capture_output=True, text=True, timeout=180, check=False
    )


@contextmanager
def daemon(home: Path, *words: str, **more: str) -> Iterator[Daemon]:
    """A command that runs until it is ended, at the latest with the block; its standard error is a file in `home`."""
    home.mkdir(parents=True, exist_ok=True)
    with (home / f"{words[0]}.stderr").open("w") as stderr:
        process = subprocess.Popen(
            [sys.executable, "-m", "pipelines.cli", *words, "--json"],
            cwd=ROOT,
            env=environment(home, **more),
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        )
        try:
            yield Daemon(process)
        finally:
            process.terminate()
            process.wait(60)


def processes_of(home: Path) -> list[str]:
    """The command lines of the processes that have this data root, by their command line or environment."""
    return list(processes_by_id(home).values())


def processes_by_id(home: Path) -> dict[int, str]:
    """The same by process id."""
    found: dict[int, str] = {}
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_text().replace("\0", " ")
            if process.name != str(os.getpid()) and str(home) in words + (process / "environ").read_text():
                found[int(process.name)] = words
        except (OSError, ValueError):
            # It ended meanwhile, or is another user's.
            continue
    return found


def wait_until(done: Any, timeout_s: float = 60) -> None:
    """Wait until `done()`; fails the test if it never is."""
    deadline_s = time.monotonic() + timeout_s
    while not done():
        assert time.monotonic() < deadline_s, f"{done} never came true"
        time.sleep(0.1)
