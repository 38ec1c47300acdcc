"""A simulated cell that lives in a thread of the test on a loopback Zenoh network of its own."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from learner.model import ActionPress, GripperSample, Recording, Track
from learner.simulation.cell.camera import Noise
from learner.simulation.cell.physics import World
from pipelines.profile import Profile
from pipelines.simulated_cell.cell import Cell
from pipelines.simulated_cell.table import scenario_of


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def open_loopback(port: int, listen: bool) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    config.insert_json5("listen/endpoints" if listen else "connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    if not listen:
        config.insert_json5("listen/endpoints", "[]")
    return zenoh.open(config)


@contextmanager
def living_cell(
    scenario: str | Profile, seed: int = 0, speed: float = 20.0, noise: Noise | None = None, port: int | None = None
) -> Iterator[zenoh.Session]:
    """Yield another session on the network of a cell `c1`; what kills the cell's thread fails the test."""
    port, stop, failures = port or free_port(), threading.Event(), list[BaseException]()
    profile = scenario if isinstance(scenario, Profile) else None
    table = scenario_of(scenario) if isinstance(scenario, Profile) else scenario
    ready = threading.Event()

    def live() -> None:
        rng = np.random.default_rng(seed)
        try:
            with (
                open_loopback(port, listen=True) as session,
                World(table, rng, noise) as world,
                Cell(session, "c1", world, rng, speed, profile=profile) as cell,
            ):
                ready.set()
                cell.run(stop)
        except BaseException as error:
            failures.append(error)
            raise
        finally:
            ready.set()

    thread = threading.Thread(target=live)
    thread.start()
    try:
        assert ready.wait(60)
        with open_loopback(port, listen=False) as session:
            yield session
    finally:
        stop.set()
        thread.join(30)
    assert not failures
    assert not thread.is_alive()


@dataclass
class Witness:
    """Everything that a cell publishes, as it comes."""

    poses: list[FrameTransforms] = field(default_factory=list)
    gripper: list[dict[str, Any]] = field(default_factory=list)
    actions: list[dict[str, Any]] = field(default_factory=list)
    encodings: set[str] = field(default_factory=set)

    def take(self, sample: zenoh.Sample) -> None:
        topic, payload = str(sample.key_expr).rsplit("/", 1)[-1], sample.payload.to_bytes()
        self.encodings.add(str(sample.encoding))
        if topic == "poses":
            self.poses.append(FrameTransforms.FromString(payload))
        else:
            {"gripper": self.gripper, "action": self.actions}[topic].append(json.loads(payload))

    def recording(self, task: str, objects: list[str], outcome: str = "success") -> Recording:
        """What was witnessed, as the recorder's reader would give it."""
        gripper = [GripperSample(each["stamp_ns"], each["state"], each["width_m"]) for each in self.gripper]
        presses = [ActionPress(each["stamp_ns"], each["type"], each.get("object")) for each in self.actions]
        return Recording("d1", task, "u1", "c1", "base", "tool0", tuple(objects), outcome, self.tracks(),
                         tuple(gripper), tuple(presses), "0" * 64, parents=frozenset({"base"}))  # fmt: skip

    def tracks(self) -> dict[str, Track]:
        rows: dict[str, list[tuple[int, list[float], list[float]]]] = {}
        for message in list(self.poses):
            for each in message.transforms:
                at, turn = each.translation, each.rotation
                row = (each.timestamp.ToNanoseconds(), [at.x, at.y, at.z], [turn.x, turn.y, turn.z, turn.w])
                rows.setdefault(each.child_frame_id, []).append(row)
        return {
            child: Track(*(np.array(column) for column in zip(*sorted(found), strict=True)))
            for child, found in rows.items()
        }


@contextmanager
def witness(session: zenoh.Session, cell: str = "c1") -> Iterator[Witness]:
    seen = Witness()
    subscribers = [
        session.declare_subscriber(f"treewright/{cell}/{topic}", seen.take) for topic in ("poses", "gripper", "action")
    ]
    try:
        yield seen
    finally:
        for subscriber in subscribers:
            subscriber.undeclare()
