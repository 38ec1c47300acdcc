"""A run tells of itself while it runs: the nodes as they tick, to whoever looks on; and anybody may end it."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import zenoh
from support_cell import KinematicCell, free_endpoint, session_on

from learner.execution.perception import CellState
from learner.model import Definition, InGripper, Node, ObjectAt, Pose, Tree
from learner.model.tree import fallback, leaf, sequence
from pipelines.controller.cell_link import CellLink
from pipelines.controller.controller import Controller, RunResult
from pipelines.controller.progress import Progress
from pipelines.controller.trace import Trace

DOWN = (1.0, 0.0, 0.0, 0.0)
IN_BOX = (0.1, 0.0, 0.0)


def motion(kind: str, frame: str, at: tuple[float, float, float]) -> Node:
    return Node(kind, (("frame", frame), ("object", "A"), ("orientation", DOWN), ("position", at)))


TREE = Tree(
    Definition(
        "Main",
        fallback(
            leaf(ObjectAt("A", "box", IN_BOX, 0.02)),
            sequence(
                fallback(leaf(InGripper("A")), motion("Pick", "A", (0.0, 0.0, 0.0))), motion("Place", "box", IN_BOX)
            ),
        ),
    )
)
NODES = list(TREE.flattened().walk())


class Onlooker:
    """Hears what a run publishes, and keeps what every node was said to be."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self.heard: list[dict[str, Any]] = []
        self.nodes: dict[str, str | None] = {}
        self._subscriber = session.declare_subscriber("treewright/c1/run/status", self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        document = json.loads(bytes(sample.payload))
        self.nodes |= document["nodes"]
        self.heard.append(document)

    def ask(self, what: str) -> dict[str, Any]:
        (reply,) = self._session.get(f"treewright/c1/run/{what}", payload="{}")
        assert reply.ok is not None
        answer: dict[str, Any] = json.loads(bytes(reply.ok.payload))
        return answer

    def until(self, **told: str) -> None:
        """Until something was told in which these fields are so."""
        end_s = time.monotonic() + 20
        while not any(told.items() <= each.items() for each in list(self.heard)):
            assert time.monotonic() < end_s, f"{told} was never told"
            time.sleep(0.01)


class Run:
    """A controller on a cell that runs beside the test."""

    def __init__(self, session: zenoh.Session, cell: KinematicCell, folder: Path) -> None:
        self.session, self.cell, self.folder = session, cell, folder
        self.pool = ThreadPoolExecutor()
        self.stop = threading.Event()

    def start(self) -> Future[RunResult]:
        return self.pool.submit(self._run)

    def _run(self) -> RunResult:
        state = CellState("base", "tool")
        with (
            CellLink(self.session, "c1", state) as link,
            Trace(self.folder / "trace.jsonl") as trace,
            Progress(self.session, "c1", "tidy@1", TREE.digest, self.stop) as progress,
        ):
            while state.unseen("tool") or state.gripper is None:
                link.take_in()
            return Controller(TREE.flattened(), link, trace, progress=progress).run(self.stop, 30.0)


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    with (
        session_on(free_endpoint(), "listen") as session,
        KinematicCell(session, A=Pose((0.3, 0.0, 0.0)), box=Pose((0.5, 0.3, 0.0))) as cell,
    ):
        made = Run(session, cell, tmp_path)
        yield made
        made.stop.set()
        made.pool.shutdown()


def place_of(kind: str) -> str:
    return str(next(index for index, node in enumerate(NODES) if node.kind == kind))


def test_the_nodes_are_told_as_they_tick_and_how_it_ended(run: Run) -> None:
    onlooker = Onlooker(run.session)
    assert run.start().result(30).outcome == "success"
    first, last = onlooker.heard[0], onlooker.heard[-1]
    assert (first["tree"], first["digest"], first["outcome"]) == ("tidy@1", TREE.digest, None)
    assert (last["outcome"], last["action"], last["status"]) == ("success", None, "success")
    assert {each["action"] for each in onlooker.heard} >= {"Pick A in A", "Place A in box"}
    picking = [each for each in onlooker.heard if each["nodes"].get(place_of("Pick")) == "running"]
    assert picking[0]["nodes"][place_of("ObjectAt")] == "failure"
    assert onlooker.nodes["0"] == onlooker.nodes[place_of("ObjectAt")] == "success"
    assert onlooker.nodes[place_of("Pick")] is None


def test_who_comes_later_is_told_everything(run: Run) -> None:
    onlooker = Onlooker(run.session)
    run.cell.speed_m_s = 0.05
    run.start()
    onlooker.until(action="Pick A in A")
    now = onlooker.ask("now")
    ticked = {index: status for index, status in onlooker.nodes.items() if status}
    assert now["nodes"] == ticked
    assert now["nodes"][place_of("Pick")] == "running"


def test_a_failure_is_counted_with_its_reason(run: Run) -> None:
    onlooker = Onlooker(run.session)
    run.cell.fail_next.append("the fingers slipped")
    assert run.start().result(30).outcome == "success"
    assert onlooker.heard[-1]["failures"] == {"Pick A in A": 1}
    assert any("the fingers slipped" in (each["reason"] or "") for each in onlooker.heard)


def test_anybody_on_the_network_ends_it_and_the_skill_under_way_is_cancelled(run: Run) -> None:
    onlooker = Onlooker(run.session)
    run.cell.speed_m_s = 0.05
    running = run.start()
    onlooker.until(action="Pick A in A")
    assert onlooker.ask("stop") == {"stopping": True}
    assert running.result(10).outcome == "stopped"
    assert len(run.cell.cancelled) == 1
    onlooker.until(outcome="stopped")
