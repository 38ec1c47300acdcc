"""Vocabulary 2 on a cell's network: a controller that asks, finds and waits, and `treewright world` that answers."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import zenoh
from support_cell import KinematicCell, free_endpoint, session_on

from learner.execution.perception import CellState
from learner.model.pose import Pose
from learner.model.scene import ObjectShape, Scene
from learner.model.tree import Definition, Node, Tree, asked, fallback, sequence
from learner.relations.answering import Answering
from learner.relations.grasping import Grasp
from pipelines.controller import controller
from pipelines.controller.cell_link import CellLink
from pipelines.controller.controller import Controller, RunResult
from pipelines.controller.job import Job
from pipelines.controller.trace import Trace
from pipelines.controller.world import World
from pipelines.errors import CommandError
from pipelines.network.question import ask

DOWN = (1.0, 0.0, 0.0, 0.0)
SCREW = ObjectShape((0.04, 0.04, 0.04), "cube", "screw")
SCENE = Scene({"s1": SCREW, "s2": SCREW, "bin": ObjectShape((0.2, 0.2, 0.1), open=True)})
TRAY = "base;0.5;0.3;0.0;0.05"


def node(kind: str, /, **ports: Any) -> Node:
    return Node(kind, tuple(sorted(ports.items())))


COLLECT = fallback(
    asked("CountAt", kind="screw", at=TRAY, count="2"),
    sequence(
        asked("SignalIs", signal="door", value='"open"'),
        asked("FindObject", kind="screw", at="", not_at=TRAY, object="{x}"),
        fallback(
            node("InGripper", object="{x}"),
            sequence(
                fallback(node("GripperIs", state="open"), node("SetGripper", state="open"), reactive=False),
                asked("FindGrasp", object="{x}", position="{p}", orientation="{q}"),
                node("Pick", object="{x}", frame="{x}", position="{p}", orientation="{q}"),
                reactive=False,
            ),
        ),
        node("Place", object="{x}", frame="base", position=(0.5, 0.3, 0.0), orientation=DOWN),
    ),
)
TREE = Tree(Definition("Main", COLLECT))
GRASPS = [Grasp(Pose((0.0, 0.0, 0.0), DOWN), kind="screw")]


@dataclass
class Bench:
    """A cell with two screws, and a session to it."""

    cell: KinematicCell
    session: zenoh.Session
    cells: zenoh.Session
    folder: Path

    def job(self) -> Job:
        manifest = {
            "digest": TREE.digest, "version": 1, "base_frame": "base", "end_effector_frame": "tool",
            "scene": SCENE.to_data(), "grasps": [grasp.to_data() for grasp in GRASPS],
        }  # fmt: skip
        return Job.of("task", TREE, manifest)

    def run(self, stop: threading.Event) -> RunResult:
        job = self.job()
        state = job.empty_state()
        with CellLink(self.session, "c1", state) as link, Trace(self.folder / "trace.jsonl") as trace:
            job.await_cell(link, stop, limit_s=10.0)
            return Controller(job.root, link, trace).run(stop, timeout_s=60.0)

    def signal(self, value: Any) -> None:
        sample = {"stamp_ns": time.time_ns(), "value": value}
        self.cells.put("treewright/c1/signals/door", json.dumps(sample))


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(controller, "SETTLE_S", 0.3)
    monkeypatch.setattr(controller, "STUCK_S", 1000.0)  # it waits for a door
    endpoint = free_endpoint()
    with (
        session_on(endpoint, "listen") as cells,
        KinematicCell(cells, s1=Pose((0.3, 0.0, 0.0)), s2=Pose((0.4, -0.2, 0.0)), bin=Pose((0.2, 0.4, 0.0))) as cell,
        session_on(endpoint, "connect") as ours,
    ):
        yield Bench(cell, ours, cells, tmp_path)


def test_a_controller_finds_what_it_collects_and_waits_for_the_door(bench: Bench) -> None:
    stop = threading.Event()
    with ThreadPoolExecutor() as pool:
        running = pool.submit(bench.run, stop)
        for _ in range(15):
            bench.signal("shut")
            time.sleep(0.1)
        assert bench.cell.requests == []
        while not running.done():
            bench.signal("open")
            time.sleep(0.1)
        result = running.result(1)
    assert result.outcome == "success", result.reason
    picked = [request["object"] for name, request in bench.cell.requests if name == "Pick"]
    assert sorted(picked) == ["s1", "s2"]
    events = [json.loads(line) for line in (bench.folder / "trace.jsonl").read_text().splitlines()]
    queries = [event for event in events if event.get("event") == "query" and event["node"] == "FindObject"]
    assert {event["found"]["object"] for event in queries if event["found"]} == {"s1", "s2"}


@pytest.fixture
def world(bench: Bench) -> Iterator[Bench]:
    """With somebody who answers the cell's conditions."""
    stop, state = threading.Event(), CellState("base", "tool", Answering(SCENE))
    with CellLink(bench.session, "c1", state) as link, World(bench.session, link) as answering:
        thread = threading.Thread(target=answering.run, args=[stop])
        thread.start()
        while state.unseen("s1") or state.gripper is None:
            time.sleep(0.02)
        yield bench
        stop.set()
        thread.join()


def told(bench: Bench, kind: str, /, **ports: Any) -> dict[str, Any]:
    return ask(bench.cells, f"treewright/c1/conditions/{kind}", ports, 5.0)


def test_the_conditions_of_a_cell_are_answered_for_any_engine(world: Bench) -> None:
    assert told(world, "GripperIs", state="open") == {"status": "success"}
    assert told(world, "InGripper", object="s1") == {"status": "failure"}
    place = {"object": "s1", "frame": "base", "position": [0.3, 0.0, 0.0]}
    assert told(world, "ObjectAt", **place, radius=0.05) == {"status": "success"}
    assert told(world, "ObjectRoughlyAt", **{**place, "position": [0.9, 0, 0]}, radius=0.1) == {"status": "failure"}
    posed = {**place, "radius": 0.05, "orientation": [0, 0, 0, 1], "angle": 0.2}
    assert told(world, "ObjectPosedAt", **posed) == {"status": "success"}
    assert told(world, "FindObject", kind="screw", at="", not_at="base;0.3;0;0;0.05") == {
        "status": "success", "object": "s2",
    }  # fmt: skip
    assert told(world, "CountAt", kind="screw", at="base;0.3;0;0;0.05|base;0.4;-0.2;0;0.05", count=2) == {
        "status": "success"
    }
    assert told(world, "FindHeld") == {"status": "failure"}
    assert told(world, "SignalIs", signal="door", value="true") == {"status": "failure"}


@pytest.mark.parametrize(
    ("kind", "ports", "sentence"),
    [
        ("Pick", {}, "'Pick' is no condition"),
        ("GripperIs", {"state": "ajar"}, "cannot have state = 'ajar'"),
        ("ObjectAt", {"object": "s1"}, "has the ports"),
        ("CountAt", {"kind": "screw", "at": "nowhere", "count": 1}, "cannot have at"),
        ("ObjectAt", {"object": "s1", "frame": "base", "position": [1, 2], "radius": 0.1}, "cannot have position"),
    ],
)
def test_what_is_no_condition_is_refused_in_a_sentence(
    world: Bench, kind: str, ports: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(CommandError, match=sentence):
        told(world, kind, **ports)
    assert told(world, "GripperIs", state="open") == {"status": "success"}
