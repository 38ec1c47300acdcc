"""How fast the recorder is, as ratios: against a plain recorder and against its own parts, in one run.

    ours        the recorder: ledger, chunks, syncs, verification; until `stop` has answered
    plain       callback -> queue -> thread -> mcap.Writer, one sync at the end; no ledger, no verification
    receiving   the recorder's subscriber with nothing behind it
    writing     the recorder's writer alone, fed from memory, synced at the end

All take the same messages of 1 kB from a publisher in a process of its own that waits when it has to (BLOCK).
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import queue
import socket
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

CELL = "bench"
PREFIX = f"treewright/{CELL}"
KEY = f"{PREFIX}/force"
COUNT = 200_000
SIZE_BYTES = 1_000
ROUNDS = 3
CONNECTED_S = 0.5
"""Between the publisher's token and its first message."""
START = {
    "task": "t",
    "user": "u",
    "objects": ["A"],
    "base_frame": "base",
    "end_effector_frame": "tool0",
    "unseen_ok": True,
}


def main() -> dict[str, Any]:
    """Measure, print, and return the figures."""
    found: dict[str, list[dict[str, float]]] = {name: [] for name in RECORDERS}
    for _ in range(ROUNDS):
        # Taken in turns, so that a noisy neighbour disturbs all alike.
        for name in RECORDERS:
            found[name].append(measure(name))
    rates = {name: statistics.median(each["rate"] for each in rounds) for name, rounds in found.items()}
    cpu_us = {name: statistics.median(each["cpu_us"] for each in rounds) for name, rounds in found.items()}
    writing = statistics.median(write_alone() for _ in range(ROUNDS))
    for name, rate in rates.items():
        print(
            f"{name:10} {rate / 1000:7.1f} k msg/s   {cpu_us[name]:5.1f} us CPU per message in the recorder's process"
        )
    print(f"{'writing':10} {writing / 1000:7.1f} k msg/s")
    print(f"ours / plain     {rates['ours'] / rates['plain']:.2f}   (goal 0.9)")
    print(f"ours / receiving {rates['ours'] / rates['receiving']:.2f}")
    print(f"ours / writing   {rates['ours'] / writing:.2f}")
    return {"rates": rates, "cpu_us": cpu_us, "writing": writing}


def measure(name: str) -> dict[str, float]:
    """One run of one recorder: messages per second, and CPU per message in its process [us]."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with tempfile.TemporaryDirectory(prefix="treewright-bench-") as folder:
        endpoint = _endpoint()
        recorder = context.Process(target=RECORDERS[name], args=(endpoint, Path(folder), theirs))
        recorder.start()
        try:
            assert _receive(ours) == "ready"
            held, letting_go = context.Pipe()
            publisher = context.Process(target=_publish, args=(endpoint, held))
            before_s = _cpu_s(recorder.pid)
            publisher.start()
            begun_s, ended_s, count, lost = _receive(ours)
            cpu_s = _cpu_s(recorder.pid) - before_s
            letting_go.send("all is recorded")
            publisher.join()
        finally:
            recorder.kill()
            recorder.join()
    assert count == COUNT, f"{name} recorded {count} of {COUNT}"
    assert not lost, f"{name} lost {lost}"
    return {"rate": COUNT / (ended_s - begun_s), "cpu_us": cpu_s / COUNT * 1e6}


def _receive(pipe: Connection) -> Any:
    assert pipe.poll(120), "the recorder's process does not answer"
    return pipe.recv()


def _publish(endpoint: str, pipe: Connection) -> None:
    import zenoh
    import zenoh.ext as ze

    noise = os.urandom(1 << 22)
    payloads = [noise[start : start + SIZE_BYTES] for start in range(0, len(noise) - SIZE_BYTES, SIZE_BYTES)]
    with (
        zenoh.open(_configuration(connect=endpoint)) as session,
        ze.declare_advanced_publisher(
            session,
            KEY,
            congestion_control=zenoh.CongestionControl.BLOCK,
            cache=ze.CacheConfig(1),
            sample_miss_detection=ze.MissDetectionConfig(heartbeat=0.5, sporadic_heartbeat=None),
            publisher_detection=True,
        ) as publisher,
    ):
        _await_subscriber(session)
        for number in range(COUNT):
            publisher.put(payloads[number % len(payloads)])
        # The last message tells the recorders that write what they get that there is no more.
        session.put(f"{KEY}/end", b"", congestion_control=zenoh.CongestionControl.BLOCK)
        pipe.recv()


def _await_subscriber(session: Any) -> None:
    end_s = time.monotonic() + 30
    with session.declare_publisher(KEY) as probe:
        while not probe.matching_status.matching:
            assert time.monotonic() < end_s, "no recorder subscribes"
            time.sleep(0.05)
    time.sleep(CONNECTED_S)


def _serve_ours(endpoint: str, folder: Path, pipe: Connection) -> None:
    import zenoh

    from recorder.daemon import Recorder

    with zenoh.open(_configuration(listen=endpoint)) as session, Recorder(session, CELL, folder) as recorder:
        ask = _asker(session)
        ask("start", START)
        pipe.send("ready")
        with _first(session) as first:
            while not recorder.status()["messages"].get("/force/end"):
                time.sleep(0.005)
            stopped = ask("stop", {"outcome": "unknown"})
        lost = {topic: count for topic, count in stopped["lost"].items() if count}
        pipe.send((first[0], time.monotonic(), stopped["messages"]["/force"], lost))
        time.sleep(60)


def _asker(session: Any) -> Callable[[str, Any], Any]:
    def ask(verb: str, request: Any) -> Any:
        (reply,) = list(session.get(f"{PREFIX}/recorder/{verb}", payload=json.dumps(request), timeout=60.0))
        assert reply.ok is not None, reply.err.payload.to_string()
        return json.loads(reply.ok.payload.to_bytes())

    return ask


@contextlib.contextmanager
def _first(session: Any) -> Iterator[list[float]]:
    """When the publisher's heartbeat token appeared plus the pause it makes: the start of every measurement."""
    found: list[float] = []
    with session.liveliness().declare_subscriber(
        f"{PREFIX}/**/@adv/**", lambda _: found.append(time.monotonic() + CONNECTED_S), history=True
    ):
        yield found


def _serve_plain(endpoint: str, folder: Path, pipe: Connection) -> None:
    import zenoh
    from mcap.writer import Writer

    waiting: queue.SimpleQueue[tuple[int, str, bytes]] = queue.SimpleQueue()

    def receive(sample: Any) -> None:
        waiting.put((time.time_ns(), str(sample.key_expr), sample.payload.to_bytes()))

    with zenoh.open(_configuration(listen=endpoint)) as session, (folder / "plain.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/force", "", 0)
        subscriber = session.declare_subscriber(f"{PREFIX}/**", receive)
        pipe.send("ready")
        count = 0
        with _first(session) as first:
            while True:
                log_ns, key, payload = waiting.get()
                if key != KEY:
                    break
                writer.add_message(channel, log_ns, payload, log_ns)
                count += 1
        writer.finish()
        stream.flush()
        os.fsync(stream.fileno())
        pipe.send((first[0], time.monotonic(), count, None))
        time.sleep(60)
        subscriber.undeclare()


def _serve_receiving(endpoint: str, folder: Path, pipe: Connection) -> None:
    import zenoh

    ended, count = threading.Event(), 0

    def receive(sample: Any) -> None:
        nonlocal count
        if str(sample.key_expr) == KEY:
            count += 1
        else:
            ended.set()

    with zenoh.open(_configuration(listen=endpoint)) as session:
        subscriber = session.declare_subscriber(f"{PREFIX}/**", receive)
        pipe.send("ready")
        with _first(session) as first:
            ended.wait()
        pipe.send((first[0], time.monotonic(), count, None))
        time.sleep(60)
        subscriber.undeclare()


RECORDERS: dict[str, Callable[[str, Path, Connection], None]] = {
    "ours": _serve_ours,
    "plain": _serve_plain,
    "receiving": _serve_receiving,
}


def write_alone() -> float:
    """Messages per second from memory to a durable file."""
    from recorder.recording import Demonstrated, RecordingWriter

    payload = os.urandom(SIZE_BYTES)
    demonstrated = Demonstrated("d", "t", "u", CELL, "base", "tool0", ("A",))
    with tempfile.TemporaryDirectory(prefix="treewright-bench-") as folder:
        begun_s = time.monotonic()
        with RecordingWriter(Path(folder) / "d.mcap", demonstrated) as writer:
            for number in range(COUNT):
                writer.write("/force", payload, number)
            writer.finish()
        return COUNT / (time.monotonic() - begun_s)


def _endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def _configuration(listen: str | None = None, connect: str | None = None) -> Any:
    import zenoh

    config = zenoh.Config()
    config.insert_json5("timestamping/enabled", "true")
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", json.dumps([listen] if listen else []))
    config.insert_json5("connect/endpoints", json.dumps([connect] if connect else []))
    # BLOCK gives up on a link after a while by default; here nothing is to be lost.
    config.insert_json5("transport/link/tx/queue/congestion_control/block/wait_before_close", "60000000")
    return config


def _cpu_s(pid: int | None) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
