"""A process that we start, watch and end, with all that it started itself."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import queue
import re
import select
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from pipelines.errors import CommandError

PATIENCE_S: Final = 15.0
"""How long a child may take to end after it was asked to; then it is killed."""
LONG_LOG_BYTES: Final = 8 << 20
_AN_ERROR: Final = re.compile(r"[\w.]*(Error|Exception): ")
"""Begins the last line of what Python tells of an exception."""
_PR_SET_PDEATHSIG: Final = 1
_LIBC: Final = ctypes.CDLL(None)


class ChildFailedError(CommandError):
    """A process that we started ended by itself or did not come up; its log says why."""


class Child:
    """A running process while the context is open; leaving it asks the process to end, then insists.

    Standard error goes to `log`, which is appended to; standard output too, unless the process speaks JSON, one object
    a line, which `hear` gives. To one that `listens` objects are told in the same way. The process leads a group of its
    own, so that a Ctrl-C reaches it through us alone, in our order; if the thread that started it ends, it is told to.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        environment: Mapping[str, str],
        log: Path,
        speaks_json: bool = False,
        listens: bool = False,
    ) -> None:
        self.name, self.log = name, log
        self._command, self._environment = list(command), dict(environment)
        self._speaks_json, self._listens = speaks_json, listens
        self._lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()

    def __enter__(self) -> Self:
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("ab") as log:
            self._begun_at = log.tell()
            self._process = subprocess.Popen(
                self._command,
                env=self._environment,
                stdin=subprocess.PIPE if self._listens else subprocess.DEVNULL,
                stdout=subprocess.PIPE if self._speaks_json else log,
                stderr=log,
                start_new_session=True,
                preexec_fn=_end_with_parent,  # it calls one function of the C library
            )
        if self._process.stdin is not None:
            # One that does not listen must not hold up who tells it.
            os.set_blocking(self._process.stdin.fileno(), False)
        if self._speaks_json:
            threading.Thread(target=self._read, name=f"{self.name} speaks", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def tell(self, document: Mapping[str, Any]) -> bool:
        """Tell the process something, at once. False if it does not listen, or the line is longer than a pipe takes
        whole.
        """
        assert self._process.stdin is not None
        line = json.dumps(document).encode() + b"\n"
        try:
            return len(line) <= select.PIPE_BUF and os.write(self._process.stdin.fileno(), line) == len(line)
        except (OSError, ValueError):
            return False

    def hear(self, timeout_s: float) -> dict[str, Any]:
        """The next object that the process says. Raises ChildFailedError if it ends or is silent for too long."""
        try:
            line = self._lines.get(timeout=timeout_s)
        except queue.Empty as error:
            raise ChildFailedError(f"the {self.name} said nothing for {timeout_s:g} s; see {self.log}") from error
        if line is None:
            self._process.wait()
            raise ChildFailedError(self._obituary())
        try:
            document: dict[str, Any] = json.loads(line)
        except ValueError as error:
            raise ChildFailedError(f"the {self.name} said what is no JSON: {line[:80]!r}; see {self.log}") from error
        return document

    def shorten_log(self) -> None:
        """Once the log is long, move what it holds into one beside it, `<log>.1`, in place of what was there."""
        if self.log.exists() and self.log.stat().st_size > LONG_LOG_BYTES:
            shutil.copyfile(self.log, self.log.with_name(f"{self.log.name}.1"))
            # The process appends: it goes on at the beginning.
            os.truncate(self.log, 0)

    @property
    def code(self) -> int | None:
        """Its exit code, None while it runs."""
        return self._process.poll()

    def check(self) -> None:
        """Raises ChildFailedError if the process has ended."""
        if self.code is not None:
            raise ChildFailedError(self._obituary())

    @property
    def silent(self) -> bool:
        """Whether nothing that it said waits to be heard."""
        return self._lines.empty()

    def wait(self, timeout_s: float) -> int:
        """Its exit code. Raises ChildFailedError if it does not end in time."""
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired as error:
            raise ChildFailedError(f"the {self.name} did not end within {timeout_s:g} s; see {self.log}") from error

    def end(self) -> None:
        """Ask the process to end, and do not wait for it. Does nothing to one that ended before."""
        if self.code is None:
            self._process.terminate()

    def stop(self) -> None:
        """End the process and what is left of its group. Does nothing to one that ended before."""
        self.end()
        deadline_s = time.monotonic() + PATIENCE_S
        while self.code is None and time.monotonic() < deadline_s:
            time.sleep(0.05)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def _read(self) -> None:
        """Take what the process says as it comes, so that it never waits for us; None is its end."""
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                self._lines.put(line)
        self._lines.put(None)

    def _obituary(self) -> str:
        """With the last error that it told in this life, else its last words."""
        said = [line.strip() for line in self._said().splitlines() if line.strip()]
        last = next(
            iter([line for line in reversed(said) if _AN_ERROR.match(line)] or reversed(said)), "it said nothing"
        )
        return f"the {self.name} ended with exit code {self.code}: {last} (see {self.log})"

    def _said(self) -> str:
        """What it wrote to its log."""
        if not self.log.exists():
            return ""
        written = self.log.read_bytes()
        # A log that was moved aside since begins anew.
        return written[self._begun_at if self._begun_at <= len(written) else 0 :].decode(errors="replace")


def _end_with_parent() -> None:
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
