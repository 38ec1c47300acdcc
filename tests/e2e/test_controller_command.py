"""`treewright run` as a person or a script starts it: a process that talks only through Zenoh, files and signals."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zenoh
from support_cell import KinematicCell, free_endpoint, session_on

from learner.model.condition import GripperIs, InGripper, ObjectAt, ObjectRoughlyAt
from learner.model.pose import Pose
from learner.model.tree import Definition, Node, Tree, fallback, leaf, sequence
from storage.artifacts import ArtifactStore
from storage.serving import StoreOnZenoh

pytestmark = pytest.mark.e2e

DOWN = (1.0, 0.0, 0.0, 0.0)
BOX = Pose((0.5, 0.3, 0.0))
IN_BOX = (0.1, 0.0, 0.0)
FACTS = {"base_frame": "base", "end_effector_frame": "tool"}


def motion(kind: str, frame: str, position: tuple[float, float, float]) -> Node:
    ports = {"object": "A", "frame": frame, "position": position, "orientation": DOWN}
    return Node(kind, tuple(sorted(ports.items())))


TREE = Tree(
    Definition(
        "cube_in_box",
        fallback(
            leaf(ObjectAt("A", "box", IN_BOX, 0.02)),
            sequence(
                fallback(leaf(InGripper("A")), motion("Pick", "A", (0.0, 0.0, 0.0))), motion("Place", "box", IN_BOX)
            ),
        ),
    )
)


@dataclass
class Site:
    """A network with a cell, and a home whose store holds `cube-in-box` in version 1."""

    endpoint: str
    home: Path
    cell: KinematicCell

    def command(self, *arguments: str) -> subprocess.Popen[str]:
        environment = {**os.environ, "TREEWRIGHT_HOME": str(self.home), "TREEWRIGHT_CONNECT": self.endpoint}
        words = [sys.executable, "-m", "pipelines.cli", "run", *arguments]
        return subprocess.Popen(
            words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=self.home
        )

    def run(self, *arguments: str) -> tuple[int, str, str]:
        process = self.command(*arguments)
        output, errors = process.communicate(timeout=90)
        return process.returncode, output, errors


@contextmanager
def store_in(home: Path) -> Iterator[ArtifactStore]:
    with ArtifactStore(home / "store") as store:
        store.publish("cube-in-box", TREE, FACTS)
        store.alias("cube-in-box", "latest", 1)
        yield store


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    endpoint = free_endpoint()
    with (
        session_on(endpoint, "listen") as session,
        store_in(tmp_path) as store,
        StoreOnZenoh(session, store),
        KinematicCell(session, A=Pose((0.3, 0.0, 0.0)), box=BOX) as cell,
    ):
        yield Site(endpoint, tmp_path, cell)


def document(output: str) -> dict[str, Any]:
    """The one JSON document on standard output."""
    (line,) = output.splitlines()
    parsed: dict[str, Any] = json.loads(line)
    return parsed


def sentence(errors: str) -> str:
    """The one line on standard error."""
    (line,) = errors.splitlines()
    assert "Traceback" not in errors
    return line


def test_a_served_tree_is_fetched_and_executed(site: Site) -> None:
    code, output, errors = site.run("cube-in-box@latest", "--cell", "c1", "--json")
    assert (code, errors) == (0, "")
    result = document(output)
    assert (result["outcome"], result["actions"]) == ("success", 2)
    assert result["ticks"] > 2
    trace = Path(result["trace"])
    assert trace.parent == site.home / "traces"
    events = [json.loads(line)["event"] for line in trace.read_text().splitlines()]
    assert (events[0], events[-1]) == ("run", "outcome")
    assert site.cell.held is None
    assert site.cell.objects["A"].position == pytest.approx((0.6, 0.3, 0.0), abs=1e-3)


@pytest.mark.parametrize("store", [["--store"], ["--store", "store"], ["--store", "."]])
def test_a_tree_is_read_from_a_store_on_this_machine(site: Site, store: list[str]) -> None:
    code, output, _ = site.run("cube-in-box@1", "--cell", "c1", "--dry-run", *store)
    assert code == 0
    assert "would start with Pick A in A" in output
    assert not site.cell.requests


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_cancels_the_skill_within_half_a_second(site: Site, number: signal.Signals) -> None:
    site.cell.speed_m_s = 0.05
    process = site.command("cube-in-box", "--cell", "c1", "--json")
    site.cell.wait_for_request(limit_s=60)
    sent_s = time.monotonic()
    process.send_signal(number)
    output, errors = process.communicate(timeout=30)
    assert process.returncode == 1
    assert document(output)["outcome"] == "stopped"
    assert "stopped" in sentence(errors)
    assert site.cell.cancelled[0][1] - sent_s < 0.5


def test_a_watch_tells_of_success_while_it_goes_on(site: Site) -> None:
    process = site.command("cube-in-box", "--cell", "c1", "--json", "--watch")
    assert process.stdout is not None
    assert json.loads(process.stdout.readline()) == {"ready": True}
    assert json.loads(process.stdout.readline())["event"] == "success"
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=30)
    assert (process.returncode, document(output)["outcome"]) == (0, "success")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["cube-in-box", "--cell", "nowhere"], "cell 'nowhere' publishes nothing"),
        (["cube-in-box@9", "--cell", "c1"], "9"),
        (["cube-in-box@golden", "--cell", "c1"], "golden"),
        (["towers", "--cell", "c1"], "towers"),
        (["cube-in-box@0", "--cell", "c1"], "versions are counted from 1"),
        (["../etc", "--cell", "c1"], "task name '../etc' is refused"),
        (["cube-in-box", "--cell", "artifacts"], "cell name 'artifacts' is refused"),
        (["cube-in-box", "--cell", "c1", "--store", "empty"], "there is no artifact store in empty"),
    ],
)
def test_what_cannot_be_run_is_one_sentence_and_exit_1(site: Site, arguments: list[str], said: str) -> None:
    code, output, errors = site.run(*arguments, "--json")
    assert (code, output) == (1, "")
    assert said in sentence(errors)
    assert not site.cell.requests


def test_no_trace_no_run(site: Site) -> None:
    (site.home / "traces").write_text("not a folder")
    code, _, errors = site.run("cube-in-box", "--cell", "c1")
    assert code == 1
    assert "cannot write the trace" in sentence(errors)
    assert not site.cell.requests


def test_a_missing_object_is_named(site: Site) -> None:
    site.cell.hidden.add("A")
    code, _, errors = site.run("cube-in-box", "--cell", "c1")
    assert code == 1
    assert "cell 'c1' lacks the object 'A'" in sentence(errors)


@pytest.mark.parametrize("arguments", [[], ["cube-in-box"], ["t", "--cell", "c", "--timeout", "-1"], ["t", "--no"]])
def test_wrong_usage_exits_2(site: Site, arguments: list[str]) -> None:
    assert site.run(*arguments)[0] == 2


def test_a_network_without_a_store_says_what_to_start(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with session_on(endpoint, "listen") as session, KinematicCell(session) as cell:
        code, _, errors = Site(endpoint, tmp_path, cell).run("cube-in-box", "--cell", "c1")
    assert code == 1
    assert "no artifact store answers" in sentence(errors)


SIMULATED = Tree(
    Definition(
        "object_in_box",
        fallback(
            leaf(ObjectRoughlyAt("A", "box", (0.0, 0.0, 0.0))),
            sequence(
                fallback(
                    leaf(InGripper("A")),
                    sequence(
                        fallback(leaf(GripperIs("open")), Node("SetGripper", (("state", "open"),))),
                        motion("Pick", "A", (0.0, 0.0, 0.0)),
                    ),
                ),
                motion("Drop", "box", (0.0, 0.0, 0.12)),
            ),
        ),
    )
)


@contextmanager
def simulated_cell(endpoint: str, folder: Path) -> Iterator[None]:
    options = ["--cell", "s1", "--speed", "6", "--seed", "3", "--listen", endpoint, "--json"]
    words = [sys.executable, "-m", "pipelines.cli", "sim", *options]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=folder) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["ready"] is True
        yield
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)


def asked(session: zenoh.Session, key: str, **fields: Any) -> dict[str, Any]:
    (reply,) = session.get(f"treewright/s1/sim/{key}", payload=json.dumps(fields), timeout=20)
    assert reply.ok is not None
    answer: dict[str, Any] = json.loads(bytes(reply.ok.payload))
    return answer


def test_the_simulated_cell_is_led_to_its_goal_although_the_cube_is_taken_away_midway(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with ArtifactStore(tmp_path / "store") as store:
        store.publish("object-in-box", SIMULATED, {"base_frame": "base", "end_effector_frame": "tool0"})
        store.alias("object-in-box", "latest", 1)
    with simulated_cell(endpoint, tmp_path), session_on(endpoint, "connect") as session:
        site = Site(endpoint, tmp_path, None)  # type: ignore[arg-type]  # the cell is another process
        process = site.command("object-in-box", "--cell", "s1", "--store", "--json", "--timeout", "60")
        deadline_s = time.monotonic() + 60
        while asked(session, "truth")["held"] is None:
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        asked(session, "disturb", take_from_gripper={})
        output, errors = process.communicate(timeout=90)
        assert (process.returncode, errors) == (0, "")
        truth = asked(session, "truth")
    result = document(output)
    assert result["actions"] >= 3
    assert (truth["goal"], truth["held"]) == (True, None)
