"""The service side of a shop floor: the scheduled flows, and the artifact store on Zenoh and HTTP."""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pipelines.home import Home
from pipelines.network.ownership import owned
from pipelines.service.child import Child
from pipelines.service.prefect_server import check_api, flow_runner, prefect_server
from pipelines.service.receiving import receiving
from pipelines.steps.arrivals import Arrivals
from pipelines.steps.stores import open_store
from storage.artifacts import ArtifactStore
from storage.client import PREFIX
from storage.errors import StorageUnavailableError
from storage.http import StoreOnHttp
from storage.serving import StoreOnZenoh

if TYPE_CHECKING:
    import zenoh
    from fastapi import FastAPI
    from starlette.types import ASGIApp

POLL_S: Final = 0.25
Report = Callable[[Mapping[str, Any]], None]
Pages = Callable[[ArtifactStore, "FastAPI"], "ASGIApp"]


@dataclass(frozen=True)
class Settings:
    """What is served where. `prefect_url` reuses a running server; else one is started on `prefect_port`."""

    host: str
    port: int
    prefect_port: int | None
    prefect_url: str | None
    period_s: float
    flows: bool = True
    token: str | None = None
    """With it recorders elsewhere may bring recordings; without, nobody."""


@contextmanager
def service(
    home: Home, session: zenoh.Session, settings: Settings, stop: threading.Event, extend: Pages | None = None
) -> Iterator[Service]:
    """Everything up; it ends with the block, children first. `extend` adds pages to what is served over HTTP.

    Raises StorageUnavailableError or CommandError for a port in use, UnreachableError for a Prefect server that does
    not answer, ChildFailedError for one of ours that does not come up, StoppedError if `stop` is set meanwhile.
    """
    with ExitStack() as stack:
        store = stack.enter_context(open_store(home))
        # The store first: it is quick, and what cannot be served is said before anything is started.
        told: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        routes = receiving(Arrivals(home, lambda file: told.put(_received(file))), settings.token)
        more = partial(extend, store) if extend else None
        http = stack.enter_context(StoreOnHttp(store, settings.host, settings.port, [routes], more))
        stack.enter_context(owned(session, f"{PREFIX}/serve", "an artifact store of this network"))
        stack.enter_context(StoreOnZenoh(session, store))
        children, prefect = _flows(stack, home, settings, stop) if settings.flows else ([], None)
        yield Service(store, http.url, prefect, children, told)


def _received(file: Path) -> Mapping[str, Any]:
    """The event of a recording that has arrived. The schedule ingests it."""
    return {"stamp_ns": time.time_ns(), "event": "received", "cell": file.parent.name, "file": str(file)}


def _flows(stack: ExitStack, home: Home, settings: Settings, stop: threading.Event) -> tuple[list[Child], str]:
    if settings.prefect_url:
        check_api(settings.prefect_url)
        children, url = [], settings.prefect_url
    else:
        server, url = stack.enter_context(prefect_server(home, settings.prefect_port, os.environ, stop))
        children = [server]
    runner = stack.enter_context(flow_runner(home, url, settings.period_s, os.environ, stop))
    return [*children, runner], url


class Service:
    """What is up: where the store and Prefect answer, and the processes that must stay alive."""

    def __init__(
        self,
        store: ArtifactStore,
        http: str,
        prefect: str | None,
        children: list[Child],
        told: queue.SimpleQueue[Mapping[str, Any]],
    ) -> None:
        self.http, self.prefect = http, prefect
        self._store, self._children, self._told = store, children, told

    def watch(self, stop: threading.Event, report: Report) -> None:
        """Report every change of the store, and what arrives, until `stop` is set.

        Raises ChildFailedError if a child ends by itself. A store that does not answer for a while is reported once
        and asked again.
        """
        told, unavailable = self._store.last_change(), False
        while not stop.wait(POLL_S):
            for child in self._children:
                child.check()
            while not self._told.empty():
                report(self._told.get())
            try:
                for change in self._store.changes(after=told):
                    report({name: value for name, value in vars(change).items() if name != "serial"})
                    told = change.serial
                unavailable = False
            except StorageUnavailableError as error:
                if not unavailable:
                    report({"stamp_ns": time.time_ns(), "event": "unavailable", "reason": str(error)})
                unavailable = True
