"""What a panel knows of its cell: poses, presses, and a recorder that dies and comes back."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from support_cell import free_endpoint
from support_recorder import CELL, PREFIX, START, network, wait_for

from learner.model import Pose
from pipelines.errors import CommandError
from pipelines.panel.lights import lights_of
from pipelines.panel.sentences import Voice
from pipelines.panel.watch import CellWatch, Frames
from recorder.daemon import Recorder
from recorder.wire import gripper_message, pose_message


class Bench:
    """A cell's session, a panel that watches it on another, and a recorder that is started and ended."""

    def __init__(self, cell: zenoh.Session, watch: CellWatch, folder: Path) -> None:
        self.cell, self.watch, self._folder = cell, watch, folder

    def recorder(self) -> Recorder:
        return Recorder(self.cell, CELL, self._folder)

    def state(self) -> str | None:
        status = self.watch.now().status
        return str(status["state"]) if status else None

    def show(self, **poses: tuple[float, float, float]) -> None:
        stamp_ns = time.time_ns()
        self.cell.put(f"{PREFIX}/poses", pose_message(stamp_ns, "base", {name: Pose(at) for name, at in poses.items()}))
        self.cell.put(f"{PREFIX}/gripper", gripper_message(stamp_ns, "open"))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with ExitStack() as stack:
        theirs, ours = stack.enter_context(network(free_endpoint()))
        yield Bench(theirs, stack.enter_context(CellWatch(ours, CELL, Frames())), tmp_path)


def test_a_recorder_that_ends_and_comes_back_is_told_and_takes_presses_again(bench: Bench) -> None:
    with bench.recorder():
        wait_for(lambda: bench.state() == "idle")
    wait_for(lambda: bench.state() is None)
    assert bench.watch.now().silence
    with pytest.raises(CommandError):
        bench.watch.press("pick", None)
    with bench.recorder():
        wait_for(lambda: bench.state() == "idle")
        bench.watch.button("start", START)
        assert bench.state() == "recording"
        bench.watch.press("pick", "A")
        (step,) = bench.watch.now().steps
        assert (step.type, step.object) == ("pick", "A")


def test_poses_are_known_by_name_and_the_hand_is_no_object(bench: Bench) -> None:
    wait_for(lambda: bench.show(tool0=(0.5, 0.0, 0.3), A=(0.4, 0.1, 0.0)) or bench.watch.now().gripper is not None)
    wait_for(lambda: len(bench.watch.now().poses) == 2)
    sight = bench.watch.now()
    assert sight.objects(Frames()) == ("A",)
    assert sight.poses["A"].position == pytest.approx((0.4, 0.1, 0.0))
    assert sight.gripper == "open"


@pytest.mark.parametrize(
    ("topic", "payload"),
    [
        ("poses", b"\xff\xff"),
        ("gripper", b"[]"),
        ("gripper", json.dumps({"stamp_ns": 1, "state": "ajar"}).encode()),
        ("recorder/events", b"{"),
        ("recorder/events", b'"x"'),
        ("recorder/events", b'{"event": "action", "step": "x", "type": "pick"}'),
    ],
)
def test_what_is_published_against_the_contract_is_a_light_and_hides_nothing(
    bench: Bench, topic: str, payload: bytes
) -> None:
    wait_for(lambda: bench.cell.put(f"{PREFIX}/{topic}", payload) or bool(bench.watch.now().oddity))
    wait_for(lambda: bench.show(A=(0.4, 0.1, 0.0)) or bool(bench.watch.now().poses))
    odd = lights_of(bench.watch.now(), Frames(), Voice("en"))[-1]
    assert odd.color == "yellow"
    assert topic in odd.text
