"""`treewright world --cell C`: the conditions of the contract's trees, answered for engines that are not ours.

With `--json` the first line is `{"ready": true}`. Sizes, kinds and grasps come from the manifest of a tree (`--tree`),
from a scene (`--scene`), or from the cell's profile; without any of them objects are points.
"""

from __future__ import annotations

import argparse
import signal
import threading
from typing import TYPE_CHECKING

from pipelines.console import Console
from pipelines.home import Home
from pipelines.network.session import add_zenoh_arguments, open_session
from pipelines.options import add_profile_argument

if TYPE_CHECKING:
    import zenoh

    from learner.execution.perception import CellState


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright world`."""
    parser.add_argument("--cell", required=True, metavar="C", help="name of the cell")
    known = parser.add_mutually_exclusive_group()
    known.add_argument("--tree", metavar="T[@V]", help="take frames, sizes, grasps and places from this tree")
    known.add_argument("--scene", metavar="JSON", help="sizes, symmetries and kinds (CONTRACT, section 2), or @FILE")
    add_profile_argument(parser)
    parser.add_argument("--base-frame", metavar="F", help="default: that of the tree or the profile, else base")
    parser.add_argument(
        "--end-effector-frame", metavar="F", help="default: that of the tree or the profile, else tool0"
    )
    parser.add_argument("--store", metavar="DIR", help="read the tree from this store instead of asking over Zenoh")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Answer until SIGINT or SIGTERM; returns 0."""
    from learner.model.names import check_name

    cell, stop = check_name("cell", arguments.cell), threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with open_session(arguments) as session:
        _answer(console, session, cell, _state(arguments, session, stop), stop)
    return 0


def _answer(console: Console, session: zenoh.Session, cell: str, state: CellState, stop: threading.Event) -> None:
    from pipelines.controller.cell_link import CellLink
    from pipelines.controller.world import World
    from pipelines.network.ownership import owned

    with (
        owned(session, f"treewright/{cell}/conditions", f"the conditions of cell {cell!r}"),
        CellLink(session, cell, state) as link,
        World(session, link) as world,
    ):
        console.emit({"ready": True})
        console.say(f"the conditions of the cell {cell} are answered; stop with Ctrl-C")
        world.run(stop)


def _state(arguments: argparse.Namespace, session: zenoh.Session, stop: threading.Event) -> CellState:
    from learner.execution.perception import CellState
    from learner.relations.answering import Answering
    from pipelines.profile import frames_and_scene

    if arguments.tree is not None:
        return _of_tree(arguments, session, stop)
    base, hand, scene = frames_and_scene(arguments, Home.current())
    return CellState(base, hand, Answering(scene))


def _of_tree(arguments: argparse.Namespace, session: zenoh.Session, stop: threading.Event) -> CellState:
    import os
    from pathlib import Path

    from pipelines.controller import job
    from pipelines.reference import Reference

    reference = Reference.parse(arguments.tree)
    if arguments.store is None:
        return job.from_zenoh(session, reference, stop).empty_state()
    return job.from_store(Path(arguments.store), os.environ.get("TREEWRIGHT_STORE_URL"), reference).empty_state()
