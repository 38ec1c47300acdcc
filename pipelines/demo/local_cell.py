"""A whole line on one machine: a simulated cell, its recorder and the service side, each a process of its own.

They talk over Zenoh through a router on a loopback port, which the process that opens it is itself; it is also
the operator, for whom it keeps a session.
"""

from __future__ import annotations

import argparse
import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pipelines.home import Home
from pipelines.network.question import ask
from pipelines.network.session import open_session
from pipelines.service.child import Child
from pipelines.service.prefect_server import START_S

if TYPE_CHECKING:
    import zenoh

COME_UP_S: Final = 60.0
RUN_S: Final = 300.0
FOREIGN: Final = (
    "TREEWRIGHT_CONNECT",
    "TREEWRIGHT_LISTEN",
    "TREEWRIGHT_ZENOH_CONFIG",
    "TREEWRIGHT_STORE_URL",
    "TREEWRIGHT_UPLOAD_URL",
    "PREFECT_API_URL",
)
"""What would lead its processes to another network, store or server than its own."""


@dataclass(frozen=True)
class LocalCell:
    """What is up: `session` is the operator's; `http` and `prefect` are where the service side answers."""

    home: Home
    cell: str
    session: zenoh.Session
    endpoint: str
    http: str
    prefect: str

    def ask(self, key: str, **fields: Any) -> dict[str, Any]:
        """What the cell answers to a question. Raises as `pipelines.network.question.ask`."""
        return ask(self.session, f"treewright/{self.cell}/{key}", fields)

    @contextmanager
    def controller(self, tree: str) -> Iterator[Child]:
        """`treewright run` on the cell, fetching over Zenoh; it says its result at its end."""
        words = ["run", tree, "--cell", self.cell, "--timeout", f"{RUN_S:g}"]
        with _command(self.home, self.endpoint, words) as child:
            yield child


@contextmanager
def open_local_cell(
    home: Home, cell: str, scenario: str, seed: int, speed: float, meanwhile: Callable[[zenoh.Session], None]
) -> Iterator[LocalCell]:
    """All processes up; they end with the block. `meanwhile` is called once cell and recorder are up.

    The Prefect server needs its time to come up, which `meanwhile` uses. Raises ChildFailedError if a process fails.
    """
    with ExitStack() as stack:
        endpoint = f"tcp/127.0.0.1:{_free_port()}"
        network = argparse.Namespace(connect=None, listen=[endpoint], zenoh_config=None)
        session = stack.enter_context(open_session(network, {}, mode="router"))
        service = ["serve", "--http", "127.0.0.1:0", "--prefect-port", "0", "--period", "3600"]
        simulating = ["sim", "--cell", cell, "--scenario", scenario, "--seed", str(seed), "--speed", f"{speed:g}"]
        serve, *others = (
            stack.enter_context(_command(home, endpoint, words))
            for words in (service, simulating, ["record", "--cell", cell])
        )
        for child in others:
            child.hear(COME_UP_S)
        meanwhile(session)
        serve.hear(START_S)
        serving = serve.hear(COME_UP_S)
        yield LocalCell(home, cell, session, endpoint, serving["http"], serving["prefect"])


def _command(home: Home, endpoint: str, words: list[str]) -> Child:
    """A command of treewright on its network, its JSON to be heard."""
    environment = {name: value for name, value in os.environ.items() if name not in FOREIGN}
    environment["TREEWRIGHT_HOME"] = str(home.root)
    command = [sys.executable, "-m", "pipelines.cli", *words, "--json", "--connect", endpoint]
    return Child(f"`treewright {words[0]}`", command, environment, home.logs / f"{words[0]}.log", speaks_json=True)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
