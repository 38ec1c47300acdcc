"""On a terminal, a line that says each second what a command is doing, and for how long it has been at it."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, TextIO

from learner.progress import heard_by
from pipelines.console import Console

PERIOD_S: Final = 1.0
"""The first line comes after this long [s], and then one as often: what is quick needs none."""


class Line:
    """One line of a terminal that is written anew each second while it is open, and wiped when it closes."""

    def __init__(self, stream: TextIO, doing: str) -> None:
        self._stream, self._doing = stream, doing
        self._begun_s = time.monotonic()
        self._over, self._writing = threading.Event(), threading.Lock()
        self._shown = False
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Line:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self.wipe()

    def hear(self, doing: str) -> None:
        """What is done from now on."""
        self._doing = doing

    def wipe(self) -> None:
        """Take the line away; the next one comes a second later."""
        with self._writing:
            if self._shown:
                self._write("")
            self._shown = False

    def _run(self) -> None:
        while not self._over.wait(PERIOD_S):
            with self._writing:
                self._shown = True
                self._write(f"{self._doing} ({time.monotonic() - self._begun_s:.0f} s)")

    def _write(self, text: str) -> None:
        """In place of what stood there, whatever the terminal knows of clearing lines."""
        width = shutil.get_terminal_size().columns - 1
        self._stream.write(f"\r{text[:width]:{width}}\r{text[:width]}")
        self._stream.flush()


@contextmanager
def progress(console: Console, doing: str) -> Iterator[None]:
    """Within the block, a person at a terminal sees what is told with `learner.progress.tell`, first `doing`.

    Nothing is written with `--json`, or where standard output or standard error is no terminal.
    """
    if console.as_json or not (sys.stdout.isatty() and sys.stderr.isatty()):
        yield
        return
    with Line(sys.stderr, doing) as line, heard_by(line.hear):
        console.make_room = line.wipe
        yield
