"""The loss ledger on a real network: what a cache covers is not lost, and what it does not is counted exactly."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
import zenoh.ext as ze
from support_recorder import (
    CELL,
    PREFIX,
    START,
    advanced_publisher,
    ask,
    configuration,
    free_endpoint,
    recording_cell,
    wait_for,
)

from recorder.daemon import Options, Recorder
from recorder.intake.routes import NO_CHANNEL
from recorder.recording import messages, read_header

LONG_S = 100.0
"""A stream that is silent for a moment is taken for what is latched, and a busy machine makes such moments."""
KEY = f"{PREFIX}/force"


def recorded(file: str) -> list[int]:
    return sorted(int(message.data) for _, message in messages(Path(file), frozenset({"/force"})))


@contextlib.contextmanager
def router(endpoint: str) -> Iterator[None]:
    with zenoh.open(configuration(listen=endpoint, mode="router")):
        yield


def client(endpoint: str, mode: str = "client") -> zenoh.Session:
    """A session that goes on trying to reach its router; a client's is not even open before it has."""
    return zenoh.open(
        configuration(
            connect=endpoint,
            mode=mode,
            connect__timeout_ms=-1,
            connect__exit_on_failure=False,
            connect__retry={"period_init_ms": 50, "period_max_ms": 100, "period_increase_factor": 1},
        )
    )


def reached(session: zenoh.Session) -> bool:
    try:
        return bool(ask(session, "status"))
    except (TimeoutError, KeyError, ValueError):
        return False


@pytest.mark.parametrize(("cache", "covered"), [(5_000, True), (10, False)])
def test_a_router_restart_loses_nothing_that_a_cache_covers_and_counts_the_rest(
    tmp_path: Path, cache: int, covered: bool
) -> None:
    endpoint = free_endpoint()
    published = 0
    with contextlib.ExitStack() as first:
        first.enter_context(router(endpoint))
        with (
            client(endpoint) as ours,
            client(endpoint) as theirs,
            Recorder(ours, CELL, tmp_path),
            advanced_publisher(theirs, KEY, cache=cache, block=False) as publisher,
        ):
            wait_for(lambda: reached(theirs), "the recorder behind the router")
            ask(theirs, "start", START)

            def publish(count: int) -> None:
                nonlocal published
                for _ in range(count):
                    publisher.put(str(published))
                    published += 1
                    time.sleep(0.001)

            publish(50)
            wait_for(
                lambda: ask(theirs, "status")["messages"].get("/force") == 50, "what was sent through the first router"
            )
            first.close()
            publish(200)
            with router(endpoint):
                wait_for(lambda: reached(theirs), "the recorder behind the new router")
                publish(50)
                stopped = ask(theirs, "stop", {"outcome": "unknown"})
                got = recorded(stopped["file"])
                assert len(got) == stopped["messages"]["/force"]
                assert stopped["lost"] == {"/force": published - len(got)}
                assert read_header(Path(stopped["file"])).messages_lost == stopped["lost"]
                assert (got == list(range(published))) == covered
                assert set(range(50)) < set(got)
                assert published - 1 in got


@pytest.mark.parametrize(("cache", "covered"), [(5_000, True), (20, False)])
def test_a_publisher_that_comes_late_loses_nothing_that_its_cache_covers(
    tmp_path: Path, cache: int, covered: bool
) -> None:
    """It publishes through a link that is not there yet, and goes on without a pause when the link comes."""
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        behind = free_endpoint()
        with client(behind, "peer") as late, advanced_publisher(late, KEY, cache=cache, block=False) as publisher:
            for number in range(300):
                publisher.put(str(number))
                time.sleep(0.001)
            front = cell.endpoint
            with zenoh.open(configuration(listen=behind, connect=front, mode="router")):
                number = 300
                end_s = time.monotonic() + 20
                while "/force" not in cell.ask("status")["messages"] or number < 600:
                    assert time.monotonic() < end_s
                    publisher.put(str(number))
                    number += 1
                stopped = cell.ask("stop", {"outcome": "unknown"})
    got = recorded(stopped["file"])
    assert stopped["lost"] == {"/force": number - len(got)}
    assert (got == list(range(number))) == covered


def test_a_publisher_that_dies_and_returns_is_followed(tmp_path: Path) -> None:
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        for life in range(3):
            with (
                zenoh.open(configuration(connect=cell.endpoint)) as theirs,
                advanced_publisher(theirs, KEY, block=False) as publisher,
            ):
                for number in range(100):
                    publisher.put(str(life * 100 + number))
                    time.sleep(0.0005)
                wait_for(lambda life=life: cell.ask("status")["messages"].get("/force") == (life + 1) * 100)
        stopped = cell.ask("stop", {"outcome": "unknown"})
    assert recorded(stopped["file"]) == list(range(300))
    assert stopped["lost"] == {"/force": 0}


def test_what_was_published_before_the_start_is_neither_recorded_nor_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recorder.intake.latched.SILENT_S", LONG_S)
    with recording_cell(tmp_path) as cell, advanced_publisher(cell.session, KEY) as publisher:
        for number in range(100):
            publisher.put(str(number))
        cell.ask("start", START)
        publisher.put("100")
        stopped = cell.ask("stop", {"outcome": "unknown"})
    assert recorded(stopped["file"]) == [100]
    assert stopped["lost"] == {"/force": 0}


def test_what_memory_cannot_hold_is_counted_and_actions_still_get_in(tmp_path: Path) -> None:
    """A disk that stands still, and a camera that goes on: memory is bounded, and every image left out is counted."""
    with recording_cell(tmp_path, Options(buffer_bytes=2 << 20)) as cell:
        cell.ask("start", START)
        writing = cell.recorder.machine.take.writing._writer  # type: ignore[union-attr]
        write = writing._write

        def stalled(data: bytes) -> None:
            wait_for(lambda: resumed, patience_s=60)
            write(data)

        resumed: list[bool] = []
        writing._write = stalled  # type: ignore[method-assign]
        image = bytes(100_000)
        with (
            advanced_publisher(cell.session, f"{PREFIX}/image", cache=None) as camera,
            advanced_publisher(cell.session, f"{PREFIX}/action", cache=None) as buttons,
        ):
            for number in range(100):
                camera.put(image)
                if number == 90:
                    buttons.put(f'{{"stamp_ns": {time.time_ns()}, "type": "pick"}}')
            wait_for(lambda: cell.ask("status")["overflowed"].get("/image", 0) >= 60)
            status = cell.ask("status")
            assert status["actions_durable"] == 0
            assert cell.recorder.machine.take.writing.intake.waiting_bytes < 3 << 20  # type: ignore[union-attr]
            resumed.append(True)
            wait_for(lambda: cell.ask("status")["actions_durable"] == 1)
            stopped = cell.ask("stop", {"outcome": "unknown"})
    assert stopped["lost"]["/image"] == 100 - stopped["messages"]["/image"]
    assert stopped["lost"]["/image"] == stopped["overflowed"]["/image"] >= 60
    assert stopped["messages"]["/action"] == 1


def test_a_gap_near_an_action_marks_the_demonstration(tmp_path: Path) -> None:
    with recording_cell(tmp_path, Options(buffer_bytes=-(40 << 20))) as cell:
        # No room at all: every pose is refused, as in the worst of overflows.
        cell.ask("start", START)
        stamp_ns = cell.put_poses({})
        cell.ask_now()
        cell.recorder.machine.take.writing.intake.limit_bytes = 1 << 20  # type: ignore[union-attr]
        cell.press("pick", stamp_ns=stamp_ns)
        wait_for(lambda: cell.ask("status")["messages"].get("/action") == 1)
        stopped = cell.ask("stop", {"outcome": "unknown"})
    assert stopped["gaps"] == ["1 messages of /poses were lost near the action pick"]
    assert read_header(Path(stopped["file"])).gaps == tuple(stopped["gaps"])


@pytest.mark.parametrize("between", ["recording", "idle"])
def test_a_publisher_with_a_fixed_id_that_is_started_again_is_followed(tmp_path: Path, between: str) -> None:
    """Its second life numbers its samples from 0 under the same source."""
    with recording_cell(tmp_path) as cell:
        for life in range(2):
            if life == 0 or between == "idle":
                cell.ask("start", START)
            with (
                zenoh.open(configuration(connect=cell.endpoint, id="aa11")) as theirs,
                advanced_publisher(theirs, KEY) as publisher,
            ):
                wait_for(lambda theirs=theirs: reached(theirs))
                for number in range(200):
                    publisher.put(str(life * 200 + number))
                expected = 200 * (life + 1) if between == "recording" else 200
                wait_for(lambda expected=expected: cell.ask("status")["messages"].get("/force") == expected)
            if life == 1 or between == "idle":
                stopped = cell.ask("stop", {"outcome": "unknown"})
    assert recorded(stopped["file"]) == list(range(0 if between == "recording" else 200, 400))
    assert stopped["lost"] == {"/force": 0}
    assert stopped["notes"] == ["a publisher of /force was started again and begins a new account"]


def test_what_a_second_life_says_while_it_is_not_heard_is_had_from_its_cache(tmp_path: Path) -> None:
    """The second life has come further than the first before it is heard for the first time."""
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        with (
            zenoh.open(configuration(connect=cell.endpoint, id="aa11")) as theirs,
            advanced_publisher(theirs, KEY) as publisher,
        ):
            wait_for(lambda: reached(theirs))
            for number in range(5):
                publisher.put(str(number))
            wait_for(lambda: cell.ask("status")["messages"].get("/force") == 5)
        behind = free_endpoint()
        late_settings = configuration(
            connect=behind, mode="peer", id="aa11", connect__timeout_ms=-1, connect__exit_on_failure=False,
            connect__retry={"period_init_ms": 50, "period_max_ms": 100, "period_increase_factor": 1},
        )  # fmt: skip
        with zenoh.open(late_settings) as late, advanced_publisher(late, KEY, block=False) as publisher:
            for number in range(5, 55):
                publisher.put(str(number))
            with zenoh.open(configuration(listen=behind, connect=cell.endpoint, mode="router")):
                wait_for(lambda: cell.ask("status")["messages"].get("/force") == 55)
                stopped = cell.ask("stop", {"outcome": "unknown"})
    assert recorded(stopped["file"]) == list(range(55))
    assert stopped["lost"] == {"/force": 0}


def test_keys_without_number_leave_room_for_the_essential_and_for_the_next_demonstration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More keys than a file has channels, in each of two demonstrations."""
    monkeypatch.setattr("recorder.intake.channels.MOST", 60)
    monkeypatch.setattr("recorder.intake.channels.KEPT", 10)
    with recording_cell(tmp_path) as cell:
        for life in range(2):
            cell.ask("start", START)
            for number in range(80):
                cell.put_json(f"key{life}/{number}", number)
            cell.put_json("gripper", {"stamp_ns": time.time_ns(), "state": "open"})
            cell.put_poses({})
            stopped = cell.ask("stop", {"outcome": "unknown"})
            messages_of = stopped["messages"]
            assert messages_of["/poses"] == messages_of["/gripper"] == 1
            assert len(messages_of) == 52
            assert sum(stopped["overflowed"].values()) == 30
            assert stopped["notes"] == [f"{NO_CHANNEL} (30 times)"]
            assert NO_CHANNEL in cell.ask("status")["alarms"]
            assert json.loads(read_header(Path(stopped["file"])).more["notes"]) == stopped["notes"]
            got = [channel.topic for channel, _ in messages(Path(stopped["file"]))]
            assert len(got) == 52


@pytest.mark.parametrize("numbered", [True, False])
def test_what_is_latched_is_in_every_file(tmp_path: Path, numbered: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Published once, before the recorder was even there; streams begin with what comes after the start."""
    monkeypatch.setattr("recorder.intake.latched.SILENT_S", LONG_S)
    miss = ze.MissDetectionConfig(heartbeat=0.1) if numbered else None
    with contextlib.ExitStack() as opened:
        endpoint = free_endpoint()
        theirs = opened.enter_context(zenoh.open(configuration(listen=endpoint)))
        info = opened.enter_context(
            ze.declare_advanced_publisher(
                theirs, f"{PREFIX}/camera/info", cache=ze.CacheConfig(10), sample_miss_detection=miss
            )
        )
        buttons, stream = (
            opened.enter_context(advanced_publisher(theirs, f"{PREFIX}/{key}")) for key in ("action", "force")
        )
        for number in range(3):
            info.put(f"info {number}")
        stream.put("-1")
        buttons.put(f'{{"stamp_ns": {time.time_ns()}, "type": "pick"}}')
        ours = opened.enter_context(zenoh.open(configuration(connect=endpoint)))
        opened.enter_context(Recorder(ours, CELL, tmp_path))
        wait_for(lambda: reached(theirs), "the recorder")
        for _ in range(2):
            ask(theirs, "start", START)
            stream.put("0")
            ask(theirs, "split")
            stream.put("0")
            stopped = ask(theirs, "stop", {"outcome": "unknown"})
            for file in stopped["parts"]:
                found = [(channel.topic, message.data) for channel, message in messages(Path(file))]
                held = [data for topic, data in found if topic == "/camera/info"]
                assert held == ([b"info 0", b"info 1", b"info 2"] if numbered else [b"info 2"])
                assert {data for topic, data in found if topic == "/force"} == {b"0"}
                assert "/action" not in dict(found)
            assert stopped["lost"]["/force"] == 0
