"""What a person at a terminal sees while a command is at work, and what a program sees: nothing of it."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

from support_processes import ROOT, environment

SLOW = """
import time
from learner.progress import tell
from pipelines.console import Console
from pipelines.progress import progress
console = Console({as_json})
with progress(console, "beginning"):
    tell("sorting the cubes")
    time.sleep({seconds})
    console.say("half way")
console.say("done")
"""


def on_a_terminal(home: Path, *words: str, stdout_too: bool = True) -> str:
    """All that a process writes to the terminal that is its standard error and, if `stdout_too`, its output."""
    mine, its = pty.openpty()
    output = its if stdout_too else subprocess.DEVNULL
    process = subprocess.Popen([sys.executable, *words], cwd=ROOT, env=environment(home), stdout=output, stderr=its)
    os.close(its)
    said = b""
    while chunk := _read(mine):
        said += chunk
    os.close(mine)
    assert process.wait(60) == 0
    return said.decode()


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 4096)
    except OSError:  # how a terminal says that nobody writes to it any more
        return b""


def slow(seconds: float = 2.3, as_json: bool = False) -> tuple[str, str]:
    return "-c", SLOW.format(seconds=seconds, as_json=as_json)


def screen(said: str) -> list[str]:
    """The lines that stand on the terminal in the end."""
    lines: list[str] = []
    for line in said.replace("\r\n", "\n").split("\n"):
        shown = ""
        for part in line.split("\r"):
            shown = part + shown[len(part) :]
        lines.append(shown.rstrip())
    return lines


def test_work_that_takes_seconds_is_told_each_second_and_leaves_no_trace_on_the_screen(tmp_path: Path) -> None:
    said = on_a_terminal(tmp_path, *slow())
    assert [f"sorting the cubes ({second} s)" in said for second in (0, 1, 2, 3)] == [False, True, True, False]
    assert screen(said) == ["half way", "done", ""]


def test_work_that_is_quick_is_not_told(tmp_path: Path) -> None:
    assert on_a_terminal(tmp_path, *slow(0.1)) == "half way\r\ndone\r\n"


def test_nothing_is_told_to_a_program(tmp_path: Path) -> None:
    assert on_a_terminal(tmp_path, *slow(1.2, as_json=True)) == ""
    assert on_a_terminal(tmp_path, *slow(1.2), stdout_too=False) == ""
    done = subprocess.run([sys.executable, *slow(1.2)], cwd=ROOT, env=environment(tmp_path), capture_output=True,
                          text=True, check=True)  # fmt: skip
    assert (done.stdout, done.stderr) == ("half way\ndone\n", "")
