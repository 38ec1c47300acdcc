"""The README's commands, each executed as it stands there but for the port."""

from __future__ import annotations

import contextlib
import math
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support_processes import ROOT, command, environment, processes_of
from support_recordings import object_in_box

from pipelines.cli import COMMANDS

pytestmark = pytest.mark.e2e
README = (ROOT / "README.md").read_text()


def blocks() -> Iterator[list[str]]:
    """The commands of each shell block, comments left out."""
    for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL):
        lines = (line.partition("#")[0].strip() for line in block.splitlines())
        yield [line for line in lines if line]


SET_UP, AFTER_THE_DEMO, *_ = blocks()
ON_A_CELL = "".join(re.findall(r"```sh\n(.*?)```", README.partition("\n## On a cell\n")[2], re.DOTALL))
"""The commands from nothing to a robot that does the task, as they are typed one after the other."""


def test_the_two_commands_of_the_first_screen_do_what_they_say() -> None:
    assert SET_UP == ["make demo", "make test"]
    for line, does in zip(SET_UP, ("/treewright demo", "/pytest"), strict=True):
        done = subprocess.run([*shlex.split(line), "-n"], cwd=ROOT, capture_output=True, text=True, check=True)
        assert does in done.stdout


def test_every_file_that_the_readme_points_to_is_there() -> None:
    named = re.findall(r"`((?:learner|recorder|storage|pipelines|docker|tests)/[\w/.]*)`", README)
    linked = re.findall(r"\]\((\w+\.md)\)", README)
    assert named
    assert linked
    assert [name for name in (*named, *linked) if not (ROOT / name).exists()] == []


def test_every_command_of_the_readme_exists() -> None:
    mentioned = set(re.findall(r"treewright (?!-)([a-z]+) ", README)) - {"makes"}
    assert mentioned <= set(COMMANDS)


def test_the_commands_for_after_the_demo_work_on_a_data_root(tmp_path: Path) -> None:
    home = tmp_path / "treewright-demo"
    for seed in (1, 2, 3):
        object_in_box(seed).write(home / "recordings" / f"{seed}.mcap")
    assert command(home, "ingest").returncode == 0
    first, *lines = AFTER_THE_DEMO
    assert first == "export TREEWRIGHT_HOME=treewright-demo"
    for line in lines:
        words = shlex.split(line)
        assert words[0] == "treewright"
        done = command(home, *(str(tmp_path / word) if word.endswith(".svg") else word for word in words[1:]))
        assert (done.returncode, done.stderr) == (0, ""), line
    assert (tmp_path / "object_in_box-1.svg").read_text().startswith("<")


@pytest.mark.timeout(400)
def test_the_section_on_a_cell_leads_from_nothing_to_a_robot_that_does_the_task(tmp_path: Path) -> None:
    """Every word of it, in a fresh shell in an empty folder; only the port is a free one."""
    said = followed(tmp_path, ON_A_CELL.replace("7447", str(free_port())))
    assert said.count("pick A: accepted") == said.count("drop A: accepted") == 3
    assert "learned object_in_box@1 (latest)" in said
    assert "has all that object_in_box@1 needs; it would start with Pick A" in said
    assert said.count("object_in_box@1: success after ") == 2
    truth = dict(re.findall(r"^(A|box) +\((.*)\)$", said.rpartition("success after")[2], re.MULTILINE))
    (x, y, z), (bx, by, _) = ([float(number) for number in truth[name].split(",")] for name in ("A", "box"))
    assert math.hypot(x - bx, y - by) < 0.15
    assert z < 0.05
    assert processes_of(tmp_path) == []


def followed(folder: Path, commands: str) -> str:
    """What a shell says that is given the commands; it stops at the first that fails, and nothing of it is left."""
    (folder / "bin").mkdir()
    treewright = folder / "bin" / "treewright"
    treewright.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -m pipelines.cli "$@"\n')
    treewright.chmod(0o755)
    told = {name: value for name, value in environment(folder).items() if name != "TREEWRIGHT_HOME"}
    path = f"{treewright.parent}:{told['PATH']}"
    shell = subprocess.Popen(
        ["bash", "-e", "-c", commands + "\nwait"],
        cwd=folder,
        env={**told, "PATH": path, "HOME": str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        said, _ = shell.communicate(timeout=380)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(shell.pid, signal.SIGKILL)
    assert shell.returncode == 0, said
    return said


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_no_document_names_this_machine() -> None:
    documents = {file.name: file.read_text() for file in [*ROOT.glob("*.md"), *(ROOT / "docker").rglob("*.md")]}
    assert "README.md" in documents
    assert [name for name, text in documents.items() if re.search(r"/work/|/tmp/|/root/|/home/", text)] == []
