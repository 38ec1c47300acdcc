"""Traffic and random faults against a recorder: what was published must be recorded or counted as lost."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from support_recorder import CELL, PREFIX, START, advanced_publisher, ask, configuration, free_endpoint, wait_for

from recorder.daemon import Recorder
from recorder.recording import messages

FAULTS = ("router restart", "slow disk", "publisher returns", "pause", "nothing")


@dataclass
class Soaked:
    """What came of a soak, by topic."""

    published: dict[str, int] = field(default_factory=dict)
    recorded: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int | None] = field(default_factory=dict)
    repeated: int = 0
    faults: dict[str, int] = field(default_factory=dict)

    @property
    def uncounted(self) -> dict[str, int]:
        """Messages that are neither recorded nor counted as lost; negative where too many are counted."""
        return {
            topic: count - self.recorded.get(topic, 0) - (self.lost.get(topic) or 0)
            for topic, count in self.published.items()
        }


class _Publisher:
    """A process of the cell, as far as the network sees: a session, a publisher, and a thread."""

    def __init__(self, topic: str, period_s: float, size_bytes: int, cache: int, connect: Callable[[], zenoh.Session]):
        self.topic, self.period_s, self.size_bytes, self.cache = topic, period_s, size_bytes, cache
        self._connect = connect
        self.count = 0
        self._stop = threading.Event()
        self.start()

    def start(self) -> None:
        self._stop.clear()
        self._opened = contextlib.ExitStack()
        session = self._opened.enter_context(self._connect())
        self._out = self._opened.enter_context(
            advanced_publisher(session, PREFIX + self.topic, cache=self.cache, block=False)
        )
        self._thread = threading.Thread(target=self._publish)
        self._thread.start()

    def _publish(self) -> None:
        while not self._stop.wait(self.period_s):
            self._out.put(f"{self.count}:".encode().ljust(self.size_bytes, b"x"))
            self.count += 1

    def rest(self) -> None:
        """Publish no more, and stay."""
        self._stop.set()
        self._thread.join()

    def close(self) -> None:
        self.rest()
        self._opened.close()


def soak(folder: Path, rounds: int, rng: np.random.Generator) -> Soaked:
    """A recorder, three publishers and so many random faults, all through a router."""
    endpoint = free_endpoint()
    result = Soaked()

    def client() -> zenoh.Session:
        return zenoh.open(
            configuration(
                connect=endpoint,
                mode="client",
                connect__timeout_ms=20_000,
                connect__exit_on_failure=False,
                connect__retry={"period_init_ms": 50, "period_max_ms": 100, "period_increase_factor": 1},
            )
        )

    with contextlib.ExitStack() as opened:
        router = [_router(endpoint)]
        opened.callback(lambda: router[0].close())  # type: ignore[no-untyped-call]
        ours = opened.enter_context(client())
        recorder = opened.enter_context(Recorder(ours, CELL, folder))
        operator = opened.enter_context(client())
        wait_for(lambda: _reached(operator), "the recorder behind the router")
        ask(operator, "start", START)
        _make_disk_slow(recorder, rng)
        publishers = [
            _Publisher("/force", 0.001, 100, 4_000, client),
            _Publisher("/image", 0.02, 200_000, 40, client),
            _Publisher("/state", 0.005, 50, 5, client),
        ]
        for publisher in publishers:
            opened.callback(publisher.close)
        for _ in range(rounds):
            fault = str(rng.choice(FAULTS))
            result.faults[fault] = result.faults.get(fault, 0) + 1
            if fault == "router restart":
                router[0].close()  # type: ignore[no-untyped-call]
                time.sleep(rng.uniform(0.05, 0.5))
                router[0] = _router(endpoint)
                wait_for(lambda: _reached(operator), "the recorder behind the new router")
            elif fault == "slow disk":
                _stalled_until_s[0] = time.monotonic() + rng.uniform(0.1, 1.0)
            elif fault == "publisher returns":
                publisher = publishers[int(rng.integers(len(publishers)))]
                publisher.rest()
                time.sleep(1.0)  # what it still owes can be had only while it is there
                publisher.close()
                publisher.start()
            elif fault == "pause":
                time.sleep(rng.uniform(0.0, 0.3))
            time.sleep(rng.uniform(0.1, 0.4))
        for publisher in publishers:
            publisher.rest()
        wait_for(lambda: _reached(operator), "the recorder at the end")
        stopped = ask(operator, "stop", {"outcome": "unknown"})
        result.published = {publisher.topic: publisher.count for publisher in publishers}
    _read(Path(stopped["file"]), result)
    result.lost = stopped["lost"]
    return result


_stalled_until_s = [0.0]


def _make_disk_slow(recorder: Recorder, rng: np.random.Generator) -> None:
    now: Any = recorder.machine.take
    writer = now.writing._writer
    write = writer._write

    def slow(data: bytes) -> None:
        time.sleep(max(0.0, _stalled_until_s[0] - time.monotonic()))
        write(data)

    writer._write = slow


def _read(file: Path, result: Soaked) -> None:
    seen: dict[str, list[int]] = {}
    for channel, message in messages(file):
        if not channel.topic.startswith("/recorder/"):  # not what the recorder itself shows
            seen.setdefault(channel.topic, []).append(int(message.data.partition(b":")[0]))
    result.recorded = {topic: len(set(numbers)) for topic, numbers in seen.items()}
    result.repeated = sum(len(numbers) - len(set(numbers)) for numbers in seen.values())


def _router(endpoint: str) -> zenoh.Session:
    return zenoh.open(configuration(listen=endpoint, mode="router"))


def _reached(session: zenoh.Session) -> bool:
    try:
        return bool(ask(session, "status"))
    except (TimeoutError, ValueError, KeyError):
        return False
