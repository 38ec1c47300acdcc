"""Ingests that are killed: `python support_killed_ingest.py ROOT points|times COUNT SEED`, run as a process of its own.

It forks one ingest after the other, which is killed, before anything of the lake has begun a thread in the parent:
with `points` just before or just after the n-th append to a table, with `times` at a random moment. The last ingest of
a data root is left to end.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from pipelines.home import Home
from pipelines.steps import ingest as ingesting
from storage.lake import Lake
from storage.table import Table

BATCH = 3
"""Files a batch, so that a few files are many commits."""
LONGEST_S = 1.2


def run_killed(root: Path, how: str, count: int, seed: int = 0) -> None:
    """Ingest what lies below a data root, killed `count` times and then not; in a process of its own."""
    command = [sys.executable, __file__, str(root), how, str(count), str(seed)]
    subprocess.run(command, check=True, timeout=600, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})


def main(root: Path, how: str, count: int, seed: int) -> None:
    """All of it."""
    rng = np.random.default_rng(seed)
    ingesting.BATCH = BATCH  # type: ignore[misc]  # the only one who does so
    for number in range(count):
        if how == "points":
            killed = _fork(root, lambda number=number: _die_at(number // 2, after=number % 2 == 1))
        else:
            killed = _fork(root, lambda: None, after_s=float(rng.uniform(0, LONGEST_S)))
        print(f"{how} {number}: {'killed' if killed else 'ended'}", flush=True)
    assert not _fork(root, lambda: None)


def _fork(root: Path, prepare: Callable[[], None], after_s: float | None = None) -> bool:
    """One ingest; whether it was killed."""
    pid = os.fork()
    if pid == 0:
        prepare()
        home = Home(root)
        ingesting.ingest(home, Lake(home.lake))
        os._exit(0)
    if after_s is not None:
        time.sleep(after_s)
        os.kill(pid, signal.SIGKILL)
    _, status = os.waitpid(pid, 0)
    assert os.WIFSIGNALED(status) or os.waitstatus_to_exitcode(status) == 0
    return os.WIFSIGNALED(status)


def _die_at(number: int, after: bool) -> None:
    append, counted = Table.append, [0]

    def dying(table: Table, rows: pa.Table, marks: Mapping[str, int]) -> None:
        last = counted[0] == number
        counted[0] += 1
        if last and not after:
            os.kill(os.getpid(), signal.SIGKILL)
        append(table, rows, marks)
        if last:
            os.kill(os.getpid(), signal.SIGKILL)

    patched: Any = dying
    Table.append = patched  # type: ignore[method-assign]  # in a process that will be killed


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
