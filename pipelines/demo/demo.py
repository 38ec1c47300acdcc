"""The demo: a simulated cell is taught by demonstration and then does the task by itself, also when disturbed."""

from __future__ import annotations

import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pipelines.demo.local_cell import RUN_S, LocalCell, open_local_cell
from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.service.child import Child
from pipelines.service.prefect_server import run_refresh
from pipelines.simulated_cell.operator import Behavior, DemonstrationFailedError, demonstrate_scenario
from recorder.recording import read_header

if TYPE_CHECKING:
    import zenoh

CELL: Final = "demo"
TASK: Final = "object_in_box"
CUBE, BOX = "A", "box"
TRIES: Final = 3
"""How often the operator may fail at one demonstration, as a person may drop a cube beside the box."""
REFRESH_S: Final = 180.0
LATE_S: Final = 60.0
"""The controller ends by itself when its time is over; so much later it must have said so."""
HOLDS_S: Final = 1.0
"""What was placed must still be there after so long of the world's time [s]."""
LOOK_S: Final = 0.05
Say = Callable[[str], None]


@dataclass(frozen=True)
class Settings:
    """How many demonstrations, from which seed, at which speed of the cell's time."""

    demonstrations: int = 3
    seed: int = 1
    speed: float = 3.0


@dataclass(frozen=True)
class Run:
    """One run of the learned tree: what the controller says, and what the world says: `success`."""

    name: str
    success: bool
    outcome: str
    reason: str | None
    actions: int
    ticks: int
    seconds: float
    disturbances: tuple[str, ...]
    trace: str


@dataclass(frozen=True)
class Report:
    """What the demo shows: sizes, successes by the world's truth, and where each file is."""

    success: bool
    seconds: float
    tree: Mapping[str, Any]
    runs: tuple[Run, ...]
    files: Mapping[str, Any]

    def to_data(self) -> dict[str, Any]:
        """The JSON document of the command."""
        return asdict(self)


def demo(home: Home, settings: Settings, say: Say) -> Report:
    """Demonstrate, ingest, learn, publish, fetch, run, run disturbed. Raises CommandError if a part of it fails."""
    begin_s, recorded = time.monotonic(), list[str]()
    say(f"1. bringing up a simulated cell, its recorder, the store and a Prefect server in {home.root}")
    rng = np.random.default_rng(settings.seed)
    meanwhile = partial(_demonstrate, settings, rng, recorded, say)
    with open_local_cell(home, CELL, TASK, settings.seed, settings.speed, meanwhile) as local:
        manifest = _learn(local, say)
        pictures = _save_tree(local)
        say("4. the robot does it by itself, from a new start")
        first = _run(local, rng, "from a new start", lambda _: iter(()))
        _tell_run(first, say)
        say("5. and again, while the cube is taken away and the box moved")
        second = _run(local, rng, "disturbed", partial(_disturb, local))
        _tell_run(second, say)
    runs = (first, second)
    tree = {name: manifest[name] for name in ("task", "version", "digest", "nodes", "nodes_recovery", "nodes_written")}
    files = {"home": str(home.root), "recordings": recorded, "lake": str(home.lake), "store": str(home.store)}
    files |= {**pictures, "traces": [run.trace for run in runs], "logs": str(home.logs)}
    return Report(all(run.success for run in runs), round(time.monotonic() - begin_s, 1), tree, runs, files)


def _demonstrate(
    settings: Settings, rng: np.random.Generator, recorded: list[str], say: Say, session: zenoh.Session
) -> None:
    """Append to `recorded` the files of so many demonstrations that reached the goal."""
    say(f"2. an operator shows {settings.demonstrations} times how the cube gets into the box, which stands anywhere")
    for number in range(settings.demonstrations):
        reply = _one_demonstration(session, rng)
        recorded.append(reply["file"])
        counts = ", ".join(f"{count} on {topic}" for topic, count in sorted(reply["messages"].items()))
        say(f"   {number + 1}: {Path(reply['file']).name}, messages: {counts}")


def _one_demonstration(session: zenoh.Session, rng: np.random.Generator) -> dict[str, Any]:
    """A demonstration that succeeded; one that did not is done again, as a person would."""
    for _ in range(TRIES):
        try:
            reply = demonstrate_scenario(session, CELL, TASK, TASK, "operator", rng, Behavior())
        except DemonstrationFailedError as error:
            failure = str(error)
            continue
        if read_header(Path(reply["file"])).outcome == "success":
            return reply
        failure = "the cube did not come to rest in the box"
    raise CommandError(f"the operator failed {TRIES} times in a row; the last time: {failure}")


def _learn(local: LocalCell, say: Say) -> dict[str, Any]:
    """Let the flows ingest and learn; returns the manifest, as the store serves it."""
    say(f"3. the flows ingest and learn, to be seen on {local.prefect.removesuffix('/api')}")
    run_refresh(local.home, local.prefect, REFRESH_S)
    manifest: dict[str, Any] = _get_json(f"{local.http}/v1/tasks/{TASK}/latest")
    sources = len(manifest["lineage"]["demonstrations"])
    size = f"{manifest['nodes']} nodes, and {manifest['nodes_recovery']} that only recover"
    say(f"   {TASK}@{manifest['version']} from {sources} demonstrations: {size}")
    return manifest


def _save_tree(local: LocalCell) -> dict[str, str]:
    """The tree and its picture, fetched over HTTP into the demo's folder."""
    files = {"xml": local.home.root / f"{TASK}.xml", "picture": local.home.root / f"{TASK}.svg"}
    for form, file in zip(("tree.xml", "tree.svg"), files.values(), strict=True):
        file.write_bytes(_get(f"{local.http}/v1/tasks/{TASK}/latest/{form}"))
    return {name: str(file) for name, file in files.items()}


def _run(local: LocalCell, rng: np.random.Generator, name: str, disturb: Callable[[Child], Iterator[str]]) -> Run:
    """Let the controller run the tree from a new start while `disturb` does its work; judged by the world."""
    local.ask("sim/reset", seed=int(rng.integers(2**31)))
    begin_s = time.monotonic()
    with local.controller(TASK) as child:
        done = tuple(disturb(child))
        result = child.hear(RUN_S + LATE_S)
    return Run(
        name=name,
        success=_goal_holds(local),
        outcome=result["outcome"],
        reason=result.get("reason"),
        actions=result["actions"],
        ticks=result["ticks"],
        seconds=round(time.monotonic() - begin_s, 1),
        disturbances=done,
        trace=result["trace"],
    )


def _disturb(local: LocalCell, child: Child) -> Iterator[str]:
    """Midway: once the cube is held it is taken out of the gripper, and once it is held again the box is moved."""
    if _await_held(local, child):
        local.ask("sim/disturb", take_from_gripper={})
        yield f"{CUBE} was taken out of the gripper and put elsewhere"
    if _await_held(local, child):
        local.ask("sim/disturb", object=BOX)
        yield f"{BOX} was moved while {CUBE} was carried"


def _await_held(local: LocalCell, child: Child) -> bool:
    """Wait until the cube is held; False if the controller ends before."""
    while child.code is None:
        if local.ask("sim/truth")["held"] == CUBE:
            return True
        time.sleep(LOOK_S)
    return False


def _goal_holds(local: LocalCell) -> bool:
    """By the world's truth: the goal holds, has held for a second, and nothing is held."""
    until_s = time.monotonic() + 10 * HOLDS_S
    truth = local.ask("sim/truth")
    while truth["goal"] and truth["goal_held_s"] < HOLDS_S and time.monotonic() < until_s:
        time.sleep(LOOK_S)
        truth = local.ask("sim/truth")
    return bool(truth["goal"] and truth["goal_held_s"] >= HOLDS_S and truth["held"] is None)


def _tell_run(run: Run, say: Say) -> None:
    for disturbance in run.disturbances:
        say(f"   {disturbance}")
    verdict = "the cube is in the box" if run.success else f"FAILED ({run.outcome}: {run.reason})"
    say(f"   {verdict} after {run.actions} actions, {run.seconds:g} s")


def _get(url: str) -> bytes:
    with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(url, timeout=30) as response:
        content: bytes = response.read()
        return content


def _get_json(url: str) -> Any:
    import json

    return json.loads(_get(url))
