"""`treewright serve`: the scheduled flows, and the artifact store on Zenoh and HTTP, until SIGINT or SIGTERM.

With --json one object a line: {"ready": true} when all is up; {"stamp_ns", "event": "serving", "http", "prefect"} with
the addresses (`prefect` null with --store-only); {"stamp_ns", "event", "task", "version", "alias", "digest"} for every
change of the store (`event` is `published` or `alias`); {"stamp_ns", "event": "received", "cell", "file"} for every
recording that a recorder elsewhere has brought, which it may with the token that TREEWRIGHT_TOKEN holds; {"stamp_ns",
"event": "unavailable", "reason"} where the store does not answer for a while; and {"stamp_ns", "event": "down", "what",
"reason"} and {"stamp_ns", "event": "up", "what"} where the Prefect server or the process of the flows does not, while
the store goes on.
"""

from __future__ import annotations

import argparse
import os
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from pipelines.commands.panel import add_view_arguments, opened_desk
from pipelines.console import Console
from pipelines.home import TOKEN, Home
from pipelines.network.session import add_zenoh_arguments, open_session
from pipelines.options import LEARNERS, PERIOD, PORT

if TYPE_CHECKING:
    import zenoh

    from pipelines.service.serve import Pages, Settings

DEFAULT_HTTP: Final = "127.0.0.1:8420"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright serve`."""
    parser.add_argument(
        "--http", type=_address, default=_address(DEFAULT_HTTP), metavar="HOST:PORT", help=f"default {DEFAULT_HTTP}"
    )
    parser.add_argument(
        "--prefect-port",
        type=PORT,
        metavar="PORT",
        help="of the Prefect server (default 4200, else any free one)",
    )
    parser.add_argument(
        "--period",
        type=PERIOD,
        default=60.0,
        metavar="S",
        help="look for new recordings so often (default 60)",
    )
    parser.add_argument(
        "--learners",
        type=LEARNERS,
        default=2,
        metavar="N",
        help="learn so many tasks at the same time (default 2)",
    )
    parser.add_argument("--store-only", action="store_true", help="serve the artifact store, run no flows")
    parser.add_argument("--cell", metavar="C", help="show the panel of this cell at `/`")
    add_view_arguments(parser)
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0 after SIGINT or SIGTERM. Where PREFECT_API_URL is set, that server is used and none is started."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        # In a thread: the handler interrupts the main thread anywhere, also where that holds the event's lock.
        signal.signal(number, lambda *_: threading.Thread(target=stop.set).start())
    from pipelines.service.prefect_server import StoppedError
    from pipelines.service.serve import service

    home = Home.current()
    with open_session(arguments) as session, _pages(arguments, session, home) as pages:
        try:
            with service(home, session, _settings(arguments), stop, pages) as up:
                console.emit({"ready": True})
                console.emit({"stamp_ns": time.time_ns(), "event": "serving", "http": up.http, "prefect": up.prefect})
                console.say(f"serving the artifact store on {up.http}/v1/tasks and over Zenoh")
                if up.prefect:
                    console.say(f"running the flows of {up.prefect.removesuffix('/api')}; end with Ctrl-C")
                up.watch(stop, lambda event: _tell(console, event))
        except StoppedError:
            console.say("told to end before everything was up")
    return 0


@contextmanager
def _pages(arguments: argparse.Namespace, session: zenoh.Session, home: Home) -> Iterator[Pages | None]:
    """The panel's pages, where a cell is named. Raises CommandError where a token is needed and nobody has one."""
    if arguments.cell is None:
        yield None
        return
    from pipelines.panel.access.login import needed_on
    from pipelines.panel.access.tokens import Tokens
    from pipelines.panel.server import with_pages

    tokens = needed_on(arguments.http[0], Tokens(home.tokens))
    with opened_desk(arguments, session, home) as desk_of:
        yield lambda store, app: with_pages(app, desk_of(store), tokens)


def _settings(arguments: argparse.Namespace) -> Settings:
    from pipelines.service.serve import Settings

    host, port = arguments.http
    return Settings(
        host=host,
        port=port,
        prefect_port=arguments.prefect_port,
        prefect_url=os.environ.get("PREFECT_API_URL") or None,
        period_s=arguments.period,
        learners=arguments.learners,
        flows=not arguments.store_only,
        token=os.environ.get(TOKEN) or None,
    )


def _tell(console: Console, event: Mapping[str, Any]) -> None:
    console.emit(event)
    if event["event"] in ("unavailable", "down"):
        console.warn(event["reason"])
        return
    if event["event"] == "received":
        console.say(f"received {event['file']}")
        return
    if event["event"] == "up":
        console.say(f"the {event['what']} is up again")
        return
    name = f"{event['task']}@{event['version']}"
    console.say(f"published {name}" if event["event"] == "published" else f"{event['alias']} is now {name}")


def _address(text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not colon:
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT")
    return host.strip("[]") or "127.0.0.1", PORT(port)
