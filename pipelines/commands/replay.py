"""`treewright replay`: publish a recording with its timing."""

from __future__ import annotations

import argparse
import signal
import threading
from pathlib import Path

from pipelines.console import Console
from pipelines.network.session import add_zenoh_arguments, open_session
from pipelines.options import DURATION, INDEX, real


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What is published, where, and how fast."""
    parser.add_argument("files", metavar="FILE", type=Path, nargs="+", help="a recording, or the parts of a split one")
    parser.add_argument("--cell", help="the cell to publish as (default: the recording's own)")
    parser.add_argument("--rate", type=real(above=0, most=1e6), default=1.0, help="so many times as fast (default 1)")
    parser.add_argument("--start", type=DURATION, default=0.0, metavar="S", help="from so long after its beginning [s]")
    parser.add_argument(
        "--loop", type=INDEX, nargs="?", const=0, default=1, metavar="N", help="N times; without N for ever"
    )
    parser.add_argument(
        "--restamp", action="store_true", help="move the stamps in the messages to now (default: as they are)"
    )
    parser.add_argument(
        "--max-gap", type=DURATION, default=5.0, metavar="S", help="longer gaps are shortened to this (default 5)"
    )
    parser.add_argument(
        "--wait", type=DURATION, default=1.0, metavar="S", help="for subscribers to connect (default 1)"
    )
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Publish. `--json`: first `{"ready": true}`, then one object a loop with the messages by topic."""
    from learner.model import check_name
    from recorder.recording import all_parts, read_header
    from recorder.replay import Replay, replay

    stopped = threading.Event()
    for ending in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending, lambda *_: stopped.set())
    files = all_parts(arguments.files)
    recorded = read_header(files[0])
    cell = check_name("cell", arguments.cell or recorded.cell)
    how = Replay(arguments.rate, arguments.start, arguments.loop or None, arguments.restamp, arguments.max_gap)
    with open_session(arguments) as session:
        console.emit({"ready": True})
        console.say(f"replaying {', '.join(map(str, files))} as the cell {cell}, {arguments.rate:g} times as fast")
        stopped.wait(arguments.wait)
        loops = replay(session, cell, files, how, stopped, console.say)
        for number, sent in enumerate(loops, start=1):
            console.emit({"loop": number, "messages": sent})
            console.say(f"loop {number}: {sum(sent.values())} messages on {', '.join(sent)}")
    return 0
