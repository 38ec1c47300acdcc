"""`treewright panel --cell C`: the page for the person at the robot, in a browser, until SIGINT or SIGTERM.

With --json one object a line: {"ready": true} when it answers, then {"event": "serving", "url"}.
"""

from __future__ import annotations

import argparse
import signal
import threading
from typing import Final

from pipelines.console import Console
from pipelines.home import Home
from pipelines.network.session import add_zenoh_arguments, open_session
from pipelines.options import PORT, add_profile_argument

DEFAULT_PORT: Final = 8421
LOOPBACK: Final = "127.0.0.1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright panel`."""
    parser.add_argument("--cell", required=True, metavar="C", help="the cell that is shown")
    parser.add_argument(
        "--port", type=PORT, default=DEFAULT_PORT, metavar="P", help=f"of {LOOPBACK}; 0: any ({DEFAULT_PORT})"
    )
    add_profile_argument(parser)
    parser.add_argument("--base-frame", metavar="F", help="default: that of the profile, else base")
    parser.add_argument("--end-effector-frame", metavar="F", help="default: that of the profile, else tool0")
    parser.add_argument(
        "--scene", metavar="JSON", help="sizes and symmetries, or @FILE; a simulated cell is asked for its own"
    )
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0 after SIGINT or SIGTERM."""
    from learner.model import check_name
    from pipelines.panel.desk import Desk
    from pipelines.panel.lessons import Lessons
    from pipelines.panel.run_watch import RunWatch
    from pipelines.panel.server import PanelServer
    from pipelines.panel.watch import CellWatch, Frames
    from pipelines.profile import frames_and_scene
    from pipelines.steps.stores import open_store

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=stop.set).start())
    home, cell = Home.current(), check_name("cell", arguments.cell)
    base, hand, scene = frames_and_scene(arguments, home)
    with (
        open_session(arguments) as session,
        open_store(home) as store,
        CellWatch(session, cell, Frames(base, hand), scene) as watch,
        RunWatch(session, cell, [*_network(arguments), "--store"], home.logs / "run.log") as runs,
        Lessons(home) as lessons,
        PanelServer(Desk(watch, runs, lessons, store), LOOPBACK, arguments.port) as server,
    ):
        console.emit({"ready": True})
        console.emit({"event": "serving", "url": server.url})
        console.say(f"the panel of the cell {cell} is at {server.url}; end with Ctrl-C")
        stop.wait()
    return 0


def _network(arguments: argparse.Namespace) -> list[str]:
    """The words that lead a controller to the network of the panel; what the environment says, it is told too."""
    endpoints = arguments.connect or arguments.listen or []
    words = [word for endpoint in endpoints for word in ("--connect", endpoint)]
    return words + (["--zenoh-config", arguments.zenoh_config] if arguments.zenoh_config else [])
