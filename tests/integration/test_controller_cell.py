"""The controller against a cell on loopback Zenoh: it reaches goals, repairs, stops, and says why it cannot."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import zenoh
from support_cell import KinematicCell, free_endpoint, session_on

from learner.execution.perception import CellState
from learner.model.condition import GripperIs, InGripper, ObjectAt
from learner.model.pose import Pose
from learner.model.tree import Definition, Node, Tree, fallback, leaf, sequence
from pipelines.controller import controller
from pipelines.controller.cell_link import CellLink
from pipelines.controller.controller import FAILURES_IN_A_ROW, Controller, RunResult
from pipelines.controller.job import Job, first_action
from pipelines.controller.trace import Trace
from pipelines.errors import CellRefusedError, CommandError, UnreachableError

DOWN = (1.0, 0.0, 0.0, 0.0)
IN_BOX = (0.1, 0.0, 0.0)
BOX = Pose((0.5, 0.3, 0.0))
ELSEWHERE = Pose((0.4, -0.3, 0.0))


def motion(kind: str, name: str, frame: str, position: tuple[float, float, float]) -> Node:
    ports = {"object": name, "frame": frame, "position": position, "orientation": DOWN}
    return Node(kind, tuple(sorted(ports.items())))


def set_gripper(state: str) -> Node:
    return Node("SetGripper", (("state", state),))


PICK = motion("Pick", "A", "A", (0.0, 0.0, 0.0))
HELD = fallback(
    leaf(InGripper("A")),
    sequence(fallback(leaf(GripperIs("open")), set_gripper("open")), PICK),
)
ROOT = fallback(
    leaf(ObjectAt("A", "box", IN_BOX, 0.02)),
    sequence(HELD, motion("Place", "A", "box", IN_BOX)),
)
TREE = Tree(Definition("Main", ROOT))


@dataclass
class Bench:
    """A cell, a link to it, and a controller that runs beside the test."""

    cell: KinematicCell
    session: zenoh.Session
    folder: Path
    stop: threading.Event = field(default_factory=threading.Event)
    pool: ThreadPoolExecutor = field(default_factory=ThreadPoolExecutor)
    told: list[dict[str, Any]] = field(default_factory=list)

    def job(self, tree: Tree = TREE, end_effector: str = "tool", base: str = "base") -> Job:
        manifest = {
            "digest": tree.digest,
            "version": 1,
            "base_frame": base,
            "end_effector_frame": end_effector,
        }
        return Job.of("task", tree, manifest)

    def link(self, job: Job) -> CellLink:
        return CellLink(self.session, "c1", CellState(job.base_frame, job.end_effector_frame))

    def start(self, tree: Tree = TREE, **options: Any) -> Future[RunResult]:
        return self.pool.submit(self._run, self.job(tree), **options)

    def _run(self, job: Job, **options: Any) -> RunResult:
        with self.link(job) as link, Trace(self.folder / "trace.jsonl") as trace:
            job.await_cell(link, self.stop, limit_s=20.0)
            return Controller(job.root, link, trace, self.told.append).run(self.stop, **options)

    def run(self, tree: Tree = TREE, **options: Any) -> RunResult:
        return self.start(tree, **options).result(60)

    def trace(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (self.folder / "trace.jsonl").read_text().splitlines()]

    @property
    def asked(self) -> list[str]:
        return [name for name, _ in self.cell.requests]


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(controller, "SETTLE_S", 0.3)
    endpoint = free_endpoint()
    with (
        session_on(endpoint, "listen") as cells,
        KinematicCell(cells, A=Pose((0.3, 0.0, 0.0)), box=BOX) as cell,
        session_on(endpoint, "connect") as ours,
    ):
        made = Bench(cell, ours, tmp_path)
        yield made
        made.stop.set()
        made.pool.shutdown()


def placed(cell: KinematicCell) -> bool:
    target = (cell.objects["box"] @ Pose(IN_BOX)).position
    return cell.held is None and max(abs(a - b) for a, b in zip(cell.objects["A"].position, target, strict=True)) < 1e-3


def test_a_tree_reaches_its_goal_and_each_step_is_in_the_trace(bench: Bench) -> None:
    result = bench.run()
    assert (result.outcome, result.actions) == ("success", 2)
    assert placed(bench.cell)
    assert bench.asked == ["Pick", "Place"]
    events = [(line["event"], line.get("action")) for line in bench.trace() if line["event"] in ("start", "end")]
    assert events == [
        ("start", "Pick A in A"),
        ("end", "Pick A in A"),
        ("start", "Place A in box"),
        ("end", "Place A in box"),
    ]
    assert bench.trace()[-1]["outcome"] == "success"


@pytest.mark.parametrize("set_by_s", [-3600, 3600, -30])
def test_a_clock_of_the_cell_that_is_set_midway_freezes_nothing(bench: Bench, set_by_s: int) -> None:
    bench.cell.speed_m_s = 0.5
    running = bench.start()
    bench.cell.wait_for_request()
    bench.cell.skew_ns = set_by_s * 1_000_000_000
    assert running.result(60).outcome == "success"
    assert placed(bench.cell)


def test_one_stamp_in_the_far_future_freezes_nothing_and_is_told(bench: Bench) -> None:
    bench.cell.mute = True
    time.sleep(0.1)
    job = bench.job()
    with bench.link(job) as link:
        link.take_in()
        bench.cell.skew_ns, bench.cell.mute = 10**18, False
        wait_until(lambda: link.take_in() or link.state.pose("A") is not None)
        bench.cell.skew_ns = 0
        wait_until(lambda: link.take_in() or link.state.now_ns < time.time_ns() + 10**12)
        bench.cell.move("A", ELSEWHERE)
        wait_until(lambda: link.take_in() or link.state.pose("A") == ELSEWHERE)
    assert any("a stamp of 'A' that is off by" in sentence for sentence in link.complaints)


def test_a_pick_that_no_one_could_believe_ends_the_run_after_three_times(bench: Bench) -> None:
    """The cell grasps the object 11 cm from its origin; by the rule of InGripper it is never held."""
    bench.cell.near_m = 0.2
    far = motion("Pick", "A", "A", (0.0, 0.0, 0.11))
    opened = fallback(leaf(GripperIs("open")), set_gripper("open"))
    held = fallback(leaf(InGripper("A")), sequence(opened, far))
    root = fallback(leaf(ObjectAt("A", "box", IN_BOX, 0.02)), sequence(held, motion("Place", "A", "box", IN_BOX)))
    result = bench.run(Tree(Definition("Main", root)))
    assert result.outcome == "failure"
    assert "Pick A succeeded 3 times, but InGripper A did not hold" in result.reason
    assert bench.asked.count("Pick") == 3


def test_a_skill_that_a_dead_controller_left_behind_is_waited_for(bench: Bench) -> None:
    bench.cell.fail_next.extend(["busy: Pick 7 is running; one skill at a time"] * (FAILURES_IN_A_ROW + 1))
    result = bench.run()
    assert result.outcome == "success"
    assert placed(bench.cell)


def test_a_request_is_the_ports_as_json_with_an_id_of_its_own(bench: Bench) -> None:
    bench.run()
    (_, pick), (_, place) = bench.cell.requests
    assert pick.pop("execution_id") != place.pop("execution_id")
    assert pick == {"object": "A", "frame": "A", "position": [0.0, 0.0, 0.0], "orientation": [1.0, 0.0, 0.0, 0.0]}
    assert place["frame"] == "box"


def test_success_is_final_only_after_it_has_lasted(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controller, "SETTLE_S", 1.0)
    bench.cell.objects["A"] = BOX @ Pose(IN_BOX)
    started_s = time.monotonic()
    result = bench.run()
    assert (result.outcome, result.actions) == ("success", 0)
    assert time.monotonic() - started_s >= controller.SETTLE_S


def test_a_cube_put_aside_during_the_run_is_fetched_again(bench: Bench) -> None:
    run = bench.start()
    bench.cell.wait_for_request(2)
    bench.cell.move("A", ELSEWHERE)
    result = run.result(60)
    assert result.outcome == "success"
    assert placed(bench.cell)
    assert bench.asked[0:2] == ["Pick", "Place"]
    assert bench.asked[-2:] == ["Pick", "Place"]


def test_a_skill_that_fails_once_is_tried_again(bench: Bench) -> None:
    bench.cell.fail_next.append("the fingers slipped")
    assert bench.run().outcome == "success"
    assert bench.asked == ["Pick", "Pick", "Place"]


def test_a_skill_that_always_fails_ends_the_run_with_its_reason(bench: Bench) -> None:
    bench.cell.fail_next.extend(["out of reach"] * 100)
    result = bench.run()
    assert result.outcome == "failure"
    assert "Pick A in A: out of reach" in result.reason
    assert result.actions == FAILURES_IN_A_ROW


def test_a_tree_without_anything_left_to_try_fails(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controller, "STUCK_S", 0.3)
    result = bench.run(Tree(Definition("Main", sequence(leaf(GripperIs("closed"))))))
    assert (result.outcome, result.actions) == ("failure", 0)


def test_stopping_cancels_the_running_skill_within_half_a_second(bench: Bench) -> None:
    bench.cell.speed_m_s = 0.05
    run = bench.start()
    bench.cell.wait_for_request()
    stopped_s = time.monotonic()
    bench.stop.set()
    assert run.result(20).outcome == "stopped"
    cancelled_id, cancelled_s = bench.cell.cancelled[0]
    assert cancelled_id == bench.cell.requests[0][1]["execution_id"]
    assert cancelled_s - stopped_s < 0.5
    assert bench.cell.gripper == "open"


def test_a_run_that_takes_too_long_is_cancelled(bench: Bench) -> None:
    bench.cell.speed_m_s = 0.01
    assert bench.run(timeout_s=0.7).outcome == "timeout"
    assert len(bench.cell.cancelled) >= 1


def test_poses_that_stop_cancel_the_skill_and_end_the_run(bench: Bench) -> None:
    bench.cell.speed_m_s = 0.05
    run = bench.start()
    bench.cell.wait_for_request()
    bench.cell.mute = True
    muted_s = time.monotonic()
    result = run.result(20)
    assert result.outcome == "lost"
    assert "no new pose of 'tool'" in result.reason
    assert 0.9 < bench.cell.cancelled[0][1] - muted_s < 2.5


def test_poses_of_objects_alone_do_not_keep_the_arm_moving(bench: Bench) -> None:
    bench.cell.speed_m_s = 0.05
    run = bench.start()
    bench.cell.wait_for_request()
    bench.cell.hidden.add("tool")
    assert run.result(20).outcome == "lost"
    assert bench.cell.cancelled


def test_a_cell_that_does_not_confirm_a_cancellation_is_reported(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controller, "CANCEL_LIMIT_S", 0.6)
    bench.cell.deaf = True
    run = bench.start()
    bench.cell.wait_for_request()
    bench.stop.set()
    result = run.result(20)
    assert result.outcome == "lost"
    assert "does not answer the cancellation of Pick A" in result.reason
    assert len(bench.cell.cancelled) >= 2


def test_a_new_action_waits_until_the_old_one_is_cancelled(bench: Bench) -> None:
    bench.cell.speed_m_s = 0.1
    aside = motion("Pick", "B", "B", (0.0, 0.0, 0.0))
    far = leaf(ObjectAt("B", "base", (0.5, -0.5, 0.0), 0.05))
    bench.cell.objects["B"] = Pose((0.5, -0.5, 0.0))
    run = bench.start(Tree(Definition("Main", fallback(sequence(far, PICK), aside))))
    bench.cell.wait_for_request(1)
    bench.cell.move("B", Pose((0.2, -0.5, 0.0)))
    bench.cell.wait_for_request(2)
    bench.stop.set()
    run.result(20)
    assert [request["object"] for _, request in bench.cell.requests] == ["A", "B"]
    assert bench.cell.cancelled[0][0] == bench.cell.requests[0][1]["execution_id"]
    answers = [line for line in bench.trace() if line["event"] == "answer"]
    assert "busy" not in [line["reason"] for line in answers]


def test_what_the_gripper_does_during_an_action_does_not_disturb_its_guards(bench: Bench) -> None:
    bench.cell.speed_m_s = 0.5
    guarded = sequence(leaf(GripperIs("open")), leaf(InGripper("none")), PICK)
    tree = Tree(Definition("Main", fallback(leaf(InGripper("A")), guarded)))
    assert bench.run(tree).outcome == "success"
    assert bench.asked == ["Pick"]
    assert not bench.cell.cancelled


def test_watching_goes_on_after_success_and_repairs(bench: Bench) -> None:
    run = bench.start(watch=True)
    wait_until(lambda: [told["event"] for told in bench.told] == ["success"])
    bench.cell.move("A", ELSEWHERE)
    wait_until(lambda: [told["event"] for told in bench.told] == ["success", "disturbed", "success"])
    bench.stop.set()
    assert run.result(20).outcome == "success"
    assert placed(bench.cell)


def wait_until(condition: Any, limit_s: float = 30.0) -> None:
    deadline_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def test_a_cell_without_an_object_or_a_frame_is_refused_by_name(bench: Bench) -> None:
    bench.cell.hidden = {"box"}
    job = bench.job()
    with (
        bench.link(job) as link,
        pytest.raises(CellRefusedError, match=r"lacks the frame 'box' of task@1.*seen are A"),
    ):
        job.await_cell(link, bench.stop, limit_s=1.0)
    bench.cell.hidden = {"A"}
    time.sleep(0.2)  # what was under way has arrived
    with bench.link(job) as link, pytest.raises(CellRefusedError, match="lacks the object 'A'"):
        job.await_cell(link, bench.stop, limit_s=1.0)
    assert not bench.cell.requests


@pytest.mark.parametrize(
    ("frames", "sentence"),
    [
        ({"end_effector": "flange"}, "lacks the end-effector frame 'flange'"),
        ({"base": "world"}, "lacks the base frame 'world'.*its poses are in 'base'"),
    ],
)
def test_a_cell_with_other_frames_is_refused_by_name(bench: Bench, frames: dict[str, str], sentence: str) -> None:
    job = bench.job(**frames)
    with bench.link(job) as link, pytest.raises(CellRefusedError, match=sentence):
        job.await_cell(link, bench.stop, limit_s=1.0)


def test_a_network_without_the_cell_is_unreachable() -> None:
    with session_on(free_endpoint(), "listen") as session:
        job = Bench(None, session, Path()).job()  # type: ignore[arg-type]  # there is no cell
        link = CellLink(session, "nowhere", CellState("base", "tool"))
        with link, pytest.raises(UnreachableError, match="'nowhere' publishes nothing"):
            job.await_cell(link, threading.Event(), limit_s=0.3)


def test_skills_that_nobody_offers_are_named(bench: Bench) -> None:
    job = bench.job()
    for queryable in bench.cell._queryables[1:2]:
        queryable.undeclare()
    with bench.link(job) as link, pytest.raises(CellRefusedError, match="lacks the skill Place"):
        job.await_cell(link, bench.stop, limit_s=1.0)
    bench.cell._queryables.pop(1)


def test_messages_against_the_contract_are_complained_of_and_harm_nothing(bench: Bench) -> None:
    job = bench.job()
    with bench.link(job) as link:
        job.await_cell(link, bench.stop, limit_s=20.0)
        for key, payload in (
            ("poses", b"\xff\xff"),
            ("gripper", b"[1]"),
            ("gripper", b'{"stamp_ns":1,"state":"ajar"}'),
        ):
            bench.session.put(f"treewright/c1/{key}", payload)
        wait_until(lambda: link.take_in() or len(link.complaints) == 3)
    assert link.state.gripper == "open"
    assert all(sentence.startswith("cell 'c1' publishes") for sentence in link.complaints)


def test_a_dry_look_names_the_first_action_and_moves_nothing(bench: Bench) -> None:
    job = bench.job()
    with bench.link(job) as link:
        job.await_cell(link, bench.stop, limit_s=20.0)
        assert first_action(job.root, link.state) == ("running", "Pick A in A")
    assert not bench.cell.requests


def test_a_manifest_that_does_not_fit_the_tree_is_refused() -> None:
    with pytest.raises(Exception, match="does not have the digest"):
        Job.of("task", TREE, {"digest": "0" * 64, "version": 1, "base_frame": "base", "end_effector_frame": "tool"})
    with pytest.raises(CommandError, match="does not state its end_effector_frame"):
        Job.of("task", TREE, {"digest": TREE.digest, "version": 1, "base_frame": "base"})
