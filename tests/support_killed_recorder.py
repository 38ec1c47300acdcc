"""A recorder in a process of its own, to be killed."""

from __future__ import annotations

import json
import multiprocessing
import socket
import threading
import time
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import zenoh
from support_recorder import (
    CELL,
    PREFIX,
    START,
    Refused,
    advanced_publisher,
    ask,
    configuration,
    free_endpoint,
    wait_for,
)

from learner.model import Pose
from recorder.daemon import Recorder
from recorder.recording import read_header, read_recording
from recorder.recovery import recover_folder
from recorder.wire import POSES_ENCODING, pose_message

TOOL = {"tool0": Pose((0.5, 0.0, 0.3)), "A": Pose((0.5, 0.0, 0.02))}
_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(["recorder.daemon", "support_recorder"])


def start_recorder(endpoint: str, folder: Path) -> BaseProcess:
    """A recorder that listens on `endpoint` until it is killed."""
    process = _context.Process(target=_serve, args=(endpoint, folder), daemon=True)
    process.start()
    return process


def _serve(endpoint: str, folder: Path) -> None:
    with zenoh.open(configuration(listen=endpoint)) as session, Recorder(session, CELL, folder):
        threading.Event().wait()


@dataclass(frozen=True)
class Life:
    """A recorder killed and recovered: actions that were durable, and how much of the stream [s] the kill has cost."""

    durable: int
    missing_s: float


def live_and_die(folder: Path, rng: np.random.Generator) -> Life:
    """Record, kill -9 at a random moment, recover. Raises AssertionError if anything durable is gone."""
    durable, killed_ns, sent, pressed = _kill_while_recording(folder, rng)
    assert recover_folder(folder, lambda *_: None) == {"recovered": 1}
    (file,) = folder.glob("*.mcap")
    recording = read_recording([file])
    assert (recording.outcome, read_header(file).more["recovered"]) == ("unknown", "true")
    stamps = [press.stamp_ns for press in recording.presses]
    assert stamps[:durable] == pressed[:durable]
    hand = recording.tracks.get("tool0")
    poses = hand.stamps_ns.tolist() if hand else []
    assert poses == sent[: len(poses)], "a hole in the middle"
    assert set(stamps[:durable]) <= set(poses)
    received = [stamp_ns for stamp_ns in sent if stamp_ns <= killed_ns]
    return Life(durable, (received[-1] - poses[-1]) / 1e9 if poses else 0.0)


def _kill_while_recording(folder: Path, rng: np.random.Generator) -> tuple[int, int, list[int], list[int]]:
    """Actions durable at the last answer, the moment of the kill, and the stamps of poses and actions sent [ns]."""
    endpoint = free_endpoint()
    process = start_recorder(endpoint, folder)
    sent: list[int] = []
    pressed: list[int] = []
    durable = 0
    try:
        wait_for(lambda: _reachable(endpoint), "the recorder's port")
        with (
            zenoh.open(configuration(connect=endpoint)) as session,
            advanced_publisher(session, f"{PREFIX}/poses", encoding=POSES_ENCODING) as poses,
            advanced_publisher(session, f"{PREFIX}/action") as buttons,
        ):
            wait_for(lambda: answers(session), "the recorder")
            ask(session, "start", START)
            stop = threading.Event()

            def publish() -> None:
                while not stop.wait(0.002):
                    stamp_ns = time.time_ns()
                    poses.put(pose_message(stamp_ns, "base", TOOL))
                    sent.append(stamp_ns)
                    if len(sent) % 25 == 0:
                        pressed.append(stamp_ns)
                        buttons.put(json.dumps({"stamp_ns": stamp_ns, "type": "pick", "object": "A"}))

            publishing = threading.Thread(target=publish)
            publishing.start()
            end_s = time.monotonic() + rng.uniform(0.1, 0.5)
            while time.monotonic() < end_s:
                durable = ask(session, "status")["actions_durable"]
            process.kill()
            killed_ns = time.time_ns()
            stop.set()
            publishing.join()
    finally:
        process.kill()
        process.join()
    return durable, killed_ns, sent, pressed


def _reachable(endpoint: str) -> bool:
    host, port = endpoint.removeprefix("tcp/").split(":")
    with socket.socket() as probe:
        return probe.connect_ex((host, int(port))) == 0


def answers(session: zenoh.Session) -> bool:
    """Whether the recorder can be reached."""
    try:
        return bool(ask(session, "status"))
    except (TimeoutError, Refused):
        return False
