"""A cell's network on loopback for the recorder's tests: real sessions, real publishers, a real recorder."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import zenoh
import zenoh.ext as ze

from learner.model import Pose
from recorder.daemon import Options, Recorder
from recorder.wire import POSES_ENCODING, pose_message

CELL = "cell1"
PREFIX = f"treewright/{CELL}"
START = {
    "task": "stacking",
    "user": "u1",
    "objects": ["A", "B"],
    "base_frame": "base",
    "end_effector_frame": "tool0",
    "unseen_ok": True,
}


def free_endpoint() -> str:
    """A TCP endpoint on loopback that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def configuration(listen: str | None = None, connect: str | None = None, **more: Any) -> zenoh.Config:
    """A configuration without multicast; `more` are JSON5 keys with `__` for `/`."""
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "timestamping/enabled": True,
        "scouting/multicast/enabled": False,
        "listen/endpoints": [listen] if listen else [],
        "connect/endpoints": [connect] if connect else [],
    }
    settings |= {key.replace("__", "/"): value for key, value in more.items()}
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


@contextlib.contextmanager
def network(endpoint: str | None = None) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """Two connected sessions: the recorder's, which listens, and the cell's."""
    endpoint = endpoint or free_endpoint()
    with zenoh.open(configuration(listen=endpoint)) as ours, zenoh.open(configuration(connect=endpoint)) as theirs:
        yield ours, theirs


@contextlib.contextmanager
def recording_cell(folder: Path, options: Options | None = None) -> Iterator[Cell]:
    """A recorder that serves the cell, and the cell's side of the network."""
    endpoint = free_endpoint()
    with network(endpoint) as (ours, theirs):
        events: list[dict[str, Any]] = []
        with (
            Recorder(ours, CELL, folder, options, events.append) as recorder,
            Cell(theirs, recorder, events, endpoint) as cell,
        ):
            cell.await_answer()
            yield cell


class Refused(Exception):  # noqa: N818  # a reply, not an error of ours
    """The recorder's error reply."""


def ask(session: zenoh.Session, verb: str, request: Any = None, prefix: str = PREFIX) -> dict[str, Any]:
    """A request to the recorder; `Refused` with the sentence of an error reply, TimeoutError for none."""
    payload = request if isinstance(request, bytes) else json.dumps({} if request is None else request).encode()
    for reply in session.get(f"{prefix}/recorder/{verb}", payload=payload, timeout=30.0):
        if reply.ok is None:
            assert reply.err is not None
            raise Refused(json.loads(reply.err.payload.to_bytes())["error"])
        answer: dict[str, Any] = json.loads(reply.ok.payload.to_bytes())
        return answer
    raise TimeoutError(f"no recorder answered {verb}")


def answers(session: zenoh.Session, prefix: str = PREFIX) -> bool:
    """Whether the recorder can be reached."""
    try:
        return bool(ask(session, "status", prefix=prefix))
    except (TimeoutError, Refused, ValueError, KeyError):
        return False


class Cell:
    """Publishes as the contract's section 1 asks of a cell."""

    def __init__(self, session: zenoh.Session, recorder: Recorder, events: list[dict[str, Any]], endpoint: str) -> None:
        self.session, self.recorder, self.events, self.endpoint = session, recorder, events, endpoint
        self._opened = contextlib.ExitStack()

    def __enter__(self) -> Cell:
        self._poses = self._opened.enter_context(
            advanced_publisher(self.session, f"{PREFIX}/poses", encoding=POSES_ENCODING)
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def ask(self, verb: str, request: Any = None) -> dict[str, Any]:
        return ask(self.session, verb, request)

    def ask_now(self) -> int:
        """The time [ns] after everything published before has reached the recorder: a request does not overtake it."""
        self.ask("status")
        return time.time_ns()

    def await_answer(self) -> None:
        """Until the recorder is reachable from the cell's session."""
        wait_for(lambda: answers(self.session))

    def put_poses(self, poses: Mapping[str, Pose], stamp_ns: int | None = None) -> int:
        stamp_ns = time.time_ns() if stamp_ns is None else stamp_ns
        self._poses.put(pose_message(stamp_ns, "base", poses))
        return stamp_ns

    def put_json(self, key: str, document: Any, encoding: str = "application/json") -> None:
        self.session.put(
            f"{PREFIX}/{key}",
            json.dumps(document),
            encoding=encoding,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )

    def press(self, kind: str, stamp_ns: int | None = None, **more: Any) -> int:
        stamp_ns = time.time_ns() if stamp_ns is None else stamp_ns
        self.put_json("action", {"stamp_ns": stamp_ns, "type": kind, **more})
        return stamp_ns

    def await_event(self, event: str, **fields: Any) -> dict[str, Any]:
        """The first event of this name with these fields."""
        found: list[dict[str, Any]] = []

        def there() -> bool:
            found[:] = [told for told in self.events if told["event"] == event and fields.items() <= told.items()]
            return bool(found)

        wait_for(there, f"the event {event} {fields} among {self.events}")
        return found[0]


def advanced_publisher(
    session: zenoh.Session,
    key: str,
    *,
    cache: int | None = 10_000,
    heartbeat_s: float = 0.1,
    block: bool = True,
    encoding: str = "zenoh/bytes",
) -> ze.AdvancedPublisher:
    """A publisher that numbers its samples and caches them, as the contract's section 1 asks."""
    return ze.declare_advanced_publisher(
        session,
        key,
        encoding=encoding,
        congestion_control=zenoh.CongestionControl.BLOCK if block else zenoh.CongestionControl.DROP,
        cache=None if cache is None else ze.CacheConfig(cache),
        sample_miss_detection=ze.MissDetectionConfig(heartbeat=heartbeat_s, sporadic_heartbeat=None),
        publisher_detection=True,
    )


def wait_for(condition: Callable[[], Any], what: str = "the condition", patience_s: float = 30.0) -> None:
    """Until a condition holds; AssertionError if it never does."""
    end_s = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < end_s, f"waited {patience_s:g} s in vain for {what}"
        time.sleep(0.01)
