"""`treewright panel --cell C`: the page for the person at the robot, in a browser, until SIGINT or SIGTERM.

With --json one object a line: {"ready": true} when it answers, then {"event": "serving", "url"}.
"""

from __future__ import annotations

import argparse
import json
import signal
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pipelines.commands.options import PORT
from pipelines.console import Console
from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.network.session import add_zenoh_arguments, open_session

if TYPE_CHECKING:
    from learner.model.scene import Scene

DEFAULT_PORT: Final = 8421
LOOPBACK: Final = "127.0.0.1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright panel`."""
    parser.add_argument("--cell", required=True, metavar="C", help="the cell that is shown")
    parser.add_argument(
        "--port", type=PORT, default=DEFAULT_PORT, metavar="P", help=f"of {LOOPBACK}; 0: any ({DEFAULT_PORT})"
    )
    parser.add_argument("--base-frame", default="base", metavar="F", help="default: base")
    parser.add_argument("--end-effector-frame", default="tool0", metavar="F", help="default: tool0")
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
    from pipelines.steps.stores import open_store

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=stop.set).start())
    base, hand = (check_name("frame", name) for name in (arguments.base_frame, arguments.end_effector_frame))
    home = Home.current()
    cell, scene = check_name("cell", arguments.cell), _scene(arguments.scene)
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


def _scene(text: str | None) -> Scene | None:
    """Raises CommandError for what is no scene."""
    from learner.model.scene import Scene

    if text is None:
        return None
    try:
        return Scene.of_data(json.loads(Path(text[1:]).read_text() if text.startswith("@") else text))
    except ValueError as error:
        raise CommandError(f"--scene: {error}") from error
