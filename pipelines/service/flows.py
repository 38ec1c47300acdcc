"""The flows of a service: a Prefect server and the process of the flows, kept, and told of what was recorded."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

from pipelines.home import Home
from pipelines.service.child import Child
from pipelines.service.keeper import Keeper
from pipelines.service.prefect_server import (
    START_S,
    StoppedError,
    api_url,
    check_api,
    flow_runner,
    is_deployed,
    is_ready,
    prefect_server,
)

if TYPE_CHECKING:
    import zenoh

    from pipelines.service.serve import Settings

POLL_S: Final = 0.25
BEGIN: Final = {"begin": True}
"""Tells the process of the flows to wait no longer for a server that is coming up."""
RECORDER_EVENTS: Final = "treewright/*/recorder/events"


class Flows:
    """What is started within the context ends with it; `tell` gets {"event": "down", …} and {"event": "up", …}."""

    def __init__(self, home: Home, settings: Settings, tell: Callable[[Mapping[str, Any]], None]) -> None:
        self.home, self.settings, self._tell = home, settings, tell
        self._stack = ExitStack()
        self._runner: Keeper | None = None
        self._settled = threading.Event()
        """The server is up, or will not be soon."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def start(self, session: zenoh.Session, store_url: str, stop: threading.Event) -> str:
        """Where Prefect answers, once it does and the flows are warm, or neither is to be expected soon. The store is
        served at `store_url`.

        Raises UnreachableError for a server of somebody else that does not answer, CommandError for a port in use,
        StoppedError if `stop` is set meanwhile.
        """
        url, server = self._server()
        self._runner = runner = self._start_runner(url, store_url)
        subscriber = session.declare_subscriber(RECORDER_EVENTS, lambda sample: self.hear(sample.payload.to_bytes()))
        self._stack.callback(subscriber.undeclare)
        if server is not None:
            server.wait(stop)
        self._settled.set()
        runner.send(BEGIN)
        runner.wait(stop)
        deadline_s = time.monotonic() + START_S
        while is_ready(url) and not is_deployed(self.home, url) and time.monotonic() < deadline_s:
            if stop.wait(POLL_S):
                break
        if stop.is_set():
            raise StoppedError
        return url

    def finished(self, file: Path) -> None:
        """A recording is finished. What is missed, the schedule finds."""
        if self._runner is not None:
            self._runner.send({"file": str(file)})

    def hear(self, payload: bytes) -> None:
        """A recorder has something to tell.

        Anybody may say anything on a network, so only what lies where recordings lie is looked at.
        """
        try:
            event = json.loads(payload)
            file = Path(event["file"]).resolve().relative_to(self.home.recordings.resolve())
            if event["event"] == "stop" and (self.home.recordings / file).is_file():
                self.finished(self.home.recordings / file)
        except (ValueError, KeyError, TypeError, OSError):
            # Not an event of a recorder of this data root.
            return

    def _server(self) -> tuple[str, Keeper | None]:
        """Where Prefect is to answer, and the server of our own, if there is none yet."""
        if url := self.settings.prefect_url:
            check_api(url)
            return url, None
        url = api_url(self.settings.prefect_port)
        return url, self._kept(lambda: prefect_server(self.home, url, os.environ), lambda _: is_ready(url))

    def _start_runner(self, url: str, store_url: str) -> Keeper:
        period_s, learners = self.settings.period_s, self.settings.learners
        return self._kept(
            lambda: flow_runner(self.home, url, store_url, period_s, learners, os.environ), _Warm(self._settled).says
        )

    def _kept(self, make: Callable[[], Child], ready: Callable[[Child], bool]) -> Keeper:
        return self._stack.enter_context(Keeper(make, ready, self._tell, START_S))


class _Warm:
    """Whether a process of the flows has said that it is ready; one that comes later need not wait for a server."""

    def __init__(self, settled: threading.Event) -> None:
        self._settled = settled
        self._child: Child | None = None

    def says(self, child: Child) -> bool:
        """Raises ChildFailedError if it has ended."""
        while not child.silent:
            if child.hear(1.0).get("ready"):
                self._child = child
                if self._settled.is_set():
                    child.tell(BEGIN)
        return self._child is child
