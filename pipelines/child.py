"""A process that we start, watch and end, with all that it started itself."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self

from pipelines.errors import CommandError

PATIENCE_S: Final = 15.0
"""How long a child may take to end after it was asked to; then it is killed."""
_PR_SET_PDEATHSIG: Final = 1
_LIBC: Final = ctypes.CDLL(None)


class ChildFailedError(CommandError):
    """A process that we started ended by itself or did not come up; its log says why."""


class Child:
    """A running process while the context is open; leaving it asks the process to end, then insists.

    Standard error goes to `log`, which is appended to; standard output too, or to `output` (a pipe for the reader).
    The process leads a group of its own, so that a Ctrl-C reaches it through us alone, in our order; if we are killed
    it is told to end.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        environment: Mapping[str, str],
        log: Path,
        piped: bool = False,
    ) -> None:
        self.name, self.log = name, log
        self._command, self._environment, self._piped = list(command), dict(environment), piped

    def __enter__(self) -> Self:
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                self._command,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if self._piped else log,
                stderr=log,
                text=True,
                start_new_session=True,
                preexec_fn=_end_with_parent,  # it calls one function of the C library
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def output(self) -> IO[str]:
        """What the process writes, if it was started `piped`."""
        assert self._process.stdout is not None
        return self._process.stdout

    @property
    def code(self) -> int | None:
        """Its exit code, None while it runs."""
        return self._process.poll()

    def check(self) -> None:
        """Raises ChildFailedError if the process has ended."""
        if self.code is not None:
            raise ChildFailedError(f"the {self.name} ended with exit code {self.code}; {self.log} says why")

    def wait(self, timeout_s: float) -> int:
        """Its exit code. Raises ChildFailedError if it does not end in time."""
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired as error:
            raise ChildFailedError(f"the {self.name} did not end within {timeout_s:g} s; see {self.log}") from error

    def stop(self) -> None:
        """End the process and what is left of its group. Does nothing to one that ended before."""
        if self.code is None:
            self._process.terminate()
        deadline_s = time.monotonic() + PATIENCE_S
        while self.code is None and time.monotonic() < deadline_s:
            time.sleep(0.05)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


def _end_with_parent() -> None:
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
