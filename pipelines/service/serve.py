"""The service side of a shop floor: the artifact store on Zenoh and HTTP, and the flows, which hear the recorders.

The store comes first and depends on nothing else: a Prefect server or a process of the flows that ends, hangs or does
not come up is told of and started again, and the store goes on.
"""

from __future__ import annotations

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
from pipelines.service.flows import Flows
from pipelines.service.receiving import receiving
from pipelines.steps.arrivals import Arrivals
from pipelines.steps.locks import owned_alone
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
    """What is served where. `prefect_url` reuses a running server; else one is started on `prefect_port`.

    What is new is looked for every `period_s` [s], and so many `learners` learn a task each at the same time.
    """

    host: str
    port: int
    prefect_port: int | None
    prefect_url: str | None
    period_s: float
    learners: int = 2
    flows: bool = True
    token: str | None = None
    """With it recorders elsewhere may bring recordings; without, nobody."""


@contextmanager
def service(
    home: Home, session: zenoh.Session, settings: Settings, stop: threading.Event, extend: Pages | None = None
) -> Iterator[Service]:
    """Everything up; it ends with the block, children first. `extend` adds pages to what is served over HTTP.

    Raises StorageUnavailableError or CommandError for a port in use, TakenError where the data root or the network has
    a service already, UnreachableError for a Prefect server that does not answer, StoppedError if `stop` is set
    meanwhile. What we start ourselves and does not come up is no reason to end: `Service.watch` tells of it.
    """
    with ExitStack() as stack:
        stack.enter_context(owned_alone(home.lock("serve"), f"a service of {home.root}"))
        store = stack.enter_context(open_store(home))
        before = store.last_change()
        # The store first: it is quick, and what cannot be served is said before anything is started.
        told: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        flows = Flows(home, settings, told.put)

        def arrived(file: Path) -> None:
            told.put(_received(file))
            flows.finished(file)

        routes = receiving(Arrivals(home, arrived), settings.token)
        more = partial(extend, store) if extend else None
        http = stack.enter_context(StoreOnHttp(store, settings.host, settings.port, [routes], more))
        stack.enter_context(owned(session, f"{PREFIX}/serve", "an artifact store of this network"))
        stack.enter_context(StoreOnZenoh(session, store))
        stack.enter_context(flows)
        prefect = flows.start(session, http.url, stop) if settings.flows else None
        yield Service(store, http.url, prefect, before, told)


def _received(file: Path) -> Mapping[str, Any]:
    """The event of a recording that has arrived."""
    return {"stamp_ns": time.time_ns(), "event": "received", "cell": file.parent.name, "file": str(file)}


class Service:
    """What is up: where the store and Prefect answer."""

    def __init__(
        self,
        store: ArtifactStore,
        http: str,
        prefect: str | None,
        before: int,
        told: queue.SimpleQueue[Mapping[str, Any]],
    ) -> None:
        self.http, self.prefect = http, prefect
        self._store, self._before, self._told = store, before, told

    def watch(self, stop: threading.Event, report: Report) -> None:
        """Report every change of the store since the service began, what arrives, and which part is down or up again,
        until `stop` is set.

        A store that does not answer for a while is reported once and asked again.
        """
        told, unavailable = self._before, False
        while not stop.wait(POLL_S):
            while not self._told.empty():
                report({"stamp_ns": time.time_ns(), **self._told.get()})
            try:
                for change in self._store.changes(after=told):
                    report({name: value for name, value in vars(change).items() if name != "serial"})
                    told = change.serial
                unavailable = False
            except StorageUnavailableError as error:
                if not unavailable:
                    report({"stamp_ns": time.time_ns(), "event": "unavailable", "reason": str(error)})
                unavailable = True
