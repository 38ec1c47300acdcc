"""`treewright panel --cell C`: the page for the person at the robot, in a browser, until SIGINT or SIGTERM.

With --json one object a line: {"ready": true} when it answers, then {"event": "serving", "url"}.
"""

from __future__ import annotations

import argparse
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from pipelines.console import Console
from pipelines.home import Home
from pipelines.network.session import add_zenoh_arguments, open_session, zenoh_words
from pipelines.options import PORT, add_profile_argument

if TYPE_CHECKING:
    import zenoh

    from pipelines.panel.desk import Desk
    from storage.artifacts import ArtifactStore

DEFAULT_PORT: Final = 8421
LOOPBACK: Final = "127.0.0.1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright panel`."""
    parser.add_argument("--cell", required=True, metavar="C", help="the cell that is shown")
    parser.add_argument(
        "--host",
        default=LOOPBACK,
        metavar="H",
        help=f"address to serve on; on others than {LOOPBACK} tokens are needed",
    )
    parser.add_argument("--port", type=PORT, default=DEFAULT_PORT, metavar="P", help=f"0: any ({DEFAULT_PORT})")
    add_view_arguments(parser)
    add_zenoh_arguments(parser)


def add_view_arguments(parser: argparse.ArgumentParser) -> None:
    """How a panel is to understand the poses of its cell."""
    add_profile_argument(parser)
    parser.add_argument("--base-frame", metavar="F", help="default: that of the profile, else base")
    parser.add_argument("--end-effector-frame", metavar="F", help="default: that of the profile, else tool0")
    parser.add_argument(
        "--scene", metavar="JSON", help="sizes and symmetries, or @FILE; a simulated cell is asked for its own"
    )


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0 after SIGINT or SIGTERM."""
    from pipelines.panel.access.tokens import Tokens
    from pipelines.panel.server import PanelServer
    from pipelines.steps.stores import open_store

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=stop.set).start())
    home = Home.current()
    with (
        open_session(arguments) as session,
        open_store(home) as store,
        opened_desk(arguments, session, home) as desk_of,
        PanelServer(desk_of(store), arguments.host, arguments.port, Tokens(home.tokens)) as server,
    ):
        console.emit({"ready": True})
        console.emit({"event": "serving", "url": server.url})
        console.say(f"the panel of the cell {arguments.cell} is at {server.url}; end with Ctrl-C")
        stop.wait()
    return 0


@contextmanager
def opened_desk(
    arguments: argparse.Namespace, session: zenoh.Session, home: Home
) -> Iterator[Callable[[ArtifactStore], Desk]]:
    """What makes a desk of a store, for the cell and the view of the options."""
    from learner.model import check_name
    from pipelines.panel.desk import open_desk
    from pipelines.panel.watch import Frames
    from pipelines.profile import frames_and_scene

    cell = check_name("cell", arguments.cell)
    base, hand, scene = frames_and_scene(arguments, home)
    with open_desk(session, home, cell, Frames(base, hand), scene, zenoh_words(arguments)) as desk_of:
        yield desk_of
