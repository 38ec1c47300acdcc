"""The README's commands, each executed as it stands there but for the port; of `serve` the store alone."""

from __future__ import annotations

import re
import shlex
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from support_processes import ROOT, command, daemon
from support_recordings import object_in_box

from pipelines.cli import COMMANDS

pytestmark = pytest.mark.e2e
README = (ROOT / "README.md").read_text()


def blocks() -> Iterator[list[str]]:
    """The commands of each shell block, comments left out."""
    for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL):
        lines = (line.partition("#")[0].strip() for line in block.splitlines())
        yield [line for line in lines if line]


SET_UP, AFTER_THE_DEMO, DAEMONS, BUTTONS, RUN = blocks()


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


@pytest.mark.timeout(300)
def test_the_commands_on_a_cell_work_together(tmp_path: Path) -> None:
    for seed in (1, 2, 3):
        object_in_box(seed).write(tmp_path / "recordings" / f"{seed}.mcap")
    assert command(tmp_path, "ingest").returncode == 0
    assert command(tmp_path, "learn", "object_in_box").returncode == 0
    port = str(free_port())
    with ExitStack() as stack:
        for line in DAEMONS:
            words = shlex.split(line.removesuffix("&").replace("7447", port))[1:]
            words += ["--http", "127.0.0.1:0", "--store-only"] if words[0] == "serve" else []
            assert stack.enter_context(daemon(tmp_path, *words)).hear()["ready"] is True
        first, *buttons = BUTTONS
        name, value = first.removeprefix("export ").split("=")
        connect = {name: value.replace("7447", port)}
        for line in [*buttons, *RUN]:
            done = command(tmp_path, *shlex.split(line)[1:], **connect)
            assert done.returncode == 0, f"{line}: {done.stderr}"
            assert done.stdout


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_no_document_names_this_machine() -> None:
    documents = {file.name: file.read_text() for file in [*ROOT.glob("*.md"), *(ROOT / "docker").rglob("*.md")]}
    assert "README.md" in documents
    assert [name for name, text in documents.items() if re.search(r"/work/|/tmp/|/root/|/home/", text)] == []
