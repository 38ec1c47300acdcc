"""Locks between processes: one after the other, or refused."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from pipelines.errors import TakenError
from pipelines.steps.locks import locked, owned_alone

HOLD = (
    "import sys; from pathlib import Path; from pipelines.steps.locks import owned_alone\n"
    "with owned_alone(Path(sys.argv[1]), 'it'): print('held', flush=True); sys.stdin.read()"
)


def test_who_comes_second_waits_for_the_first(tmp_path: Path) -> None:
    file, order, begun = tmp_path / "locks" / "a.lock", list[str](), threading.Event()

    def second() -> None:
        begun.set()
        with locked(file):
            order.append("second")

    thread = threading.Thread(target=second)
    with locked(file):
        thread.start()
        begun.wait()
        thread.join(0.2)
        order.append("first")
    thread.join(30)
    assert order == ["first", "second"]


def test_a_thread_that_holds_a_lock_takes_it_again(tmp_path: Path) -> None:
    with locked(tmp_path / "a.lock"):
        with locked(tmp_path / "a.lock"):
            pass
        with pytest.raises(TakenError), owned_alone(tmp_path / "a.lock", "it"):
            pass


def test_what_another_process_has_is_refused_with_who_has_it_until_that_is_killed(tmp_path: Path) -> None:
    file = tmp_path / "a.lock"
    words = [sys.executable, "-c", HOLD, str(file)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout
        assert holder.stdout.readline() == "held\n"
        told = f"it is running already: process {holder.pid}, since"
        with pytest.raises(TakenError, match=told), owned_alone(file, "it"):
            pass
        holder.kill()
    with owned_alone(file, "it"):
        assert f"process {os.getpid()}" in file.read_text()
