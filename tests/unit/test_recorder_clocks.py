"""Clocks that are set while something is recorded: what is learned is the same, and what happened is told."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from hypothesis import given, settings
from hypothesis import strategies as st
from support_recordings import BOX, CUBE, HAND, Take, object_in_box

from learner.model import Demonstration
from learner.model.stamps import Timeline
from learner.observation import observe
from recorder.clocks import LogClock
from recorder.recording import read_recording

NS = 1_000_000_000
HOUR = 3600 * NS
PERIOD = NS // 30
Restamp = Callable[[int, int, str], int]
"""From arrival and stamp [ns] and who stamped it to what its clock said instead."""


def stamped(take: Take, restamp: Restamp) -> Take:
    """The same demonstration, recorded at the same times, with other stamps."""

    def changed(log_ns: int, topic: str, payload: bytes) -> bytes:
        if topic == "/poses":
            message = FrameTransforms.FromString(payload)
            for transform in message.transforms:
                stamp = transform.timestamp
                stamp_ns = restamp(log_ns, stamp.seconds * NS + stamp.nanos, transform.child_frame_id)
                stamp.seconds, stamp.nanos = divmod(stamp_ns, NS)
            return message.SerializeToString()
        document = json.loads(payload)
        document["stamp_ns"] = restamp(log_ns, document["stamp_ns"], topic)
        return json.dumps(document).encode()

    return Take(
        take.metadata, [(log_ns, topic, changed(log_ns, topic, payload)) for log_ns, topic, payload in take.messages]
    )


def learned(take: Take, folder: Path) -> Demonstration:
    return observe(read_recording([take.write(folder / "one.mcap")]))


def shape(demonstration: Demonstration) -> list[object]:
    """What learning takes from a demonstration."""
    return [
        (action.type, action.object, np.round(action.end_effector.position, 3).tolist(), sorted(action.objects),
         action.rest_seen, action.rest and np.round(action.rest["base"].position, 3).tolist())
        for action in demonstration.actions
    ]  # fmt: skip


@pytest.fixture(scope="module")
def take() -> Take:
    return object_in_box(1)


@pytest.fixture(scope="module")
def expected(take: Take, tmp_path_factory: pytest.TempPathFactory) -> list[object]:
    return shape(learned(take, tmp_path_factory.mktemp("expected")))


@pytest.mark.parametrize("jump_s", [-3600.0, 3600.0, -7.0, 30.0, -1.7e9])
@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_a_cell_whose_clock_is_set_is_learned_from_as_before(
    take: Take, expected: list[object], jump_s: float, share: float, tmp_path: Path
) -> None:
    begin_ns, end_ns = take.messages[0][0], take.messages[-1][0]
    at_ns = begin_ns + int((end_ns - begin_ns) * share)
    jump_ns = int(jump_s * NS)
    demonstration = learned(stamped(take, lambda log, stamp, who: stamp + jump_ns * (log >= at_ns)), tmp_path)
    assert shape(demonstration) == expected
    told = [warning for warning in demonstration.warnings if "was set" in warning]
    assert told
    assert all("back" in each if jump_s < 0 else "ahead" in each for each in told)


def test_a_clock_that_is_set_back_and_ahead_again(take: Take, expected: list[object], tmp_path: Path) -> None:
    begin_ns, end_ns = take.messages[0][0], take.messages[-1][0]
    third = (end_ns - begin_ns) // 3

    def there_and_back(log_ns: int, stamp_ns: int, _: str) -> int:
        return stamp_ns - HOUR * (begin_ns + third <= log_ns < begin_ns + 2 * third)

    assert shape(learned(stamped(take, there_and_back), tmp_path)) == expected


@pytest.mark.parametrize("off_ns", [HOUR, -HOUR, 10 * 365 * 24 * HOUR, -1_600_000_000 * NS])
@pytest.mark.parametrize("index", [0, 1, 40])
def test_a_stray_stamp_is_left_out_and_told(
    take: Take, expected: list[object], off_ns: int, index: int, tmp_path: Path
) -> None:
    poses = [log_ns for log_ns, topic, _ in take.messages if topic == "/poses"]
    demonstration = learned(stamped(take, lambda log, stamp, who: stamp + off_ns * (log == poses[index])), tmp_path)
    assert shape(demonstration) == expected
    told = [warning for warning in demonstration.warnings if "cannot be right" in warning]
    assert {name for name in (HAND, CUBE, BOX) for each in told if name in each} == {HAND, CUBE, BOX}


def test_what_a_cache_delivers_late_stays_where_it_is() -> None:
    timeline: Timeline[int] = Timeline()
    live = [(number * PERIOD, number * PERIOD) for number in range(900) if not 300 <= number < 600]
    burst = [(number * PERIOD, 700 * PERIOD + number * NS // 100_000) for number in range(300, 600)]
    told = [
        stamp
        for stamp, arrived in sorted([*live, *burst], key=lambda pair: pair[1])
        for stamp, _ in timeline.take("A", stamp, arrived, 0)
    ]
    assert sorted([*told, *(stamp for stamp, _ in timeline.end())]) == [number * PERIOD for number in range(900)]
    assert not timeline.jumped
    assert not timeline.strays


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.integers(20, 60), st.integers(-100 * HOUR, 100 * HOUR)), min_size=1, max_size=5),
    st.integers(0, PERIOD // 3),
    st.randoms(use_true_random=False),
)
def test_whatever_steps_a_clock_takes_time_goes_on(steps: list[tuple[int, int]], jitter: int, random: object) -> None:
    """All senders of one clock are moved by the same, so that what belongs together stays together."""
    timeline: Timeline[int] = Timeline()
    told: dict[str, list[int]] = {"arm": [], "camera": []}
    clock_ns, arrived_ns = 1_700_000_000 * NS, 0
    for count, jump_ns in steps:
        clock_ns += jump_ns
        for _ in range(count):
            clock_ns, arrived_ns = clock_ns + PERIOD, arrived_ns + PERIOD + random.randint(-jitter, jitter)  # type: ignore[attr-defined]
            for sender in told:
                told[sender] += [stamp for stamp, _ in timeline.take(sender, clock_ns, arrived_ns, 0)]
    for stamps in told.values():
        assert len(stamps) == sum(count for count, _ in steps)
        assert all(-NS <= later - earlier <= 6 * NS for earlier, later in pairwise(stamps))
    assert told["arm"] == told["camera"]


def test_the_time_of_the_log_never_goes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = LogClock()
    before_ns = clock.now_ns()
    assert clock.noticed() is None
    wall = clock.offset_ns
    monkeypatch.setattr(time, "time_ns", lambda: wall + time.monotonic_ns() - HOUR)
    assert before_ns < clock.now_ns() < before_ns + NS
    assert (
        clock.noticed()
        == "the recorder's own clock was set back by 3600.0 s while recording; its log times go on without that"
    )
    assert clock.noticed() is None
    assert clock.set() == pytest.approx(-HOUR, abs=NS)
