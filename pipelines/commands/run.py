"""`treewright run T[@V] --cell C`: fetch a tree, check it and the cell, execute it (CONTRACT, sections 3 and 4).

With `--json` one document `{"outcome", "reason", "ticks", "actions", "trace"}`: `outcome` is success, failure (the
tree cannot reach its goal), timeout, stopped (by a signal) or lost (the poses stopped, or the cell does not answer);
`actions` counts those that were started; `trace` is the path of the run's JSON Lines. With `--watch` it is the last of
several, after `{"ready": true}`. `--dry-run` tells `{"outcome": "dry-run", ..., "would": [...]}`.
"""

from __future__ import annotations

import argparse
import os
import signal
import threading
import time
import uuid
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pipelines.console import Console
from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.network.session import add_zenoh_arguments, open_session
from pipelines.options import PATIENCE

if TYPE_CHECKING:
    import zenoh

    from pipelines.controller.controller import RunResult
    from pipelines.controller.job import Job
    from pipelines.reference import Reference

HOME_STORE: Final = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright run`."""
    parser.add_argument("tree", metavar="T[@V]", help="task, with a version or an alias (production, else latest)")
    parser.add_argument("--cell", required=True, metavar="C", help="name of the cell")
    parser.add_argument(
        "--store",
        nargs="?",
        const=HOME_STORE,
        metavar="DIR",
        help="read the artifact store in DIR (without DIR the one below TREEWRIGHT_HOME) instead of asking over Zenoh",
    )
    parser.add_argument("--timeout", type=PATIENCE, metavar="S", help="give up after S seconds (no limit)")
    parser.add_argument("--watch", action="store_true", help="go on after success and repair what is disturbed")
    parser.add_argument("--dry-run", action="store_true", help="fetch and check, say what would be done, move nothing")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0 if the goal was reached (or a dry run found nothing amiss), else 1."""
    from learner.model.names import check_name
    from pipelines.progress import progress
    from pipelines.reference import Reference

    reference, cell = Reference.parse(arguments.tree), check_name("cell", arguments.cell)
    stop = _stopped_by_signals()
    with open_session(arguments) as session, progress(console, f"asking the store for {reference}"):
        job = _fetched(arguments, session, reference, stop)
        console.say(f"{job.name} is {job.nodes} nodes, digest {job.digest[:12]}")
        return _on_cell(arguments, console, session, job, cell, stop)


def _stopped_by_signals() -> threading.Event:
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        # In a thread: the handler interrupts the main thread anywhere, also where that holds the event's lock.
        signal.signal(number, lambda *_: threading.Thread(target=stop.set).start())
    return stop


def _fetched(arguments: argparse.Namespace, session: zenoh.Session, reference: Reference, stop: threading.Event) -> Job:
    from pipelines.controller import job

    if arguments.store is None:
        return job.from_zenoh(session, reference, stop)
    root = Home.current().store if arguments.store == HOME_STORE else Path(arguments.store)
    return job.from_store(root, os.environ.get("TREEWRIGHT_STORE_URL"), reference)


def _on_cell(
    arguments: argparse.Namespace,
    console: Console,
    session: zenoh.Session,
    job: Job,
    cell: str,
    stop: threading.Event,
) -> int:
    from learner.progress import tell
    from pipelines.controller.cell_link import CellLink
    from pipelines.network.ownership import owned

    tell(f"looking for what the tree needs in the cell {cell}")
    with CellLink(session, cell, job.empty_state()) as link:
        job.await_cell(link, stop)
        if arguments.dry_run:
            return _say_what_would_be_done(console, job, link)
        with owned(session, f"treewright/{cell}/run", f"a tree on cell {cell!r}"):
            return _execute(arguments, console, job, link, session, stop)


def _say_what_would_be_done(console: Console, job: Job, link: Any) -> int:
    from pipelines.controller.job import first_action

    status, action = first_action(job.root, link.state)
    would = f"start with {action}" if action else f"do nothing: the tree's status is {status}"
    console.say(f"the cell {link.cell} has all that {job.name} needs; it would {would}")
    document = {"outcome": "dry-run", "ticks": 0, "actions": 0, "trace": None, "status": status, "would": action}
    console.emit(document)
    return 0


def _execute(
    arguments: argparse.Namespace,
    console: Console,
    job: Job,
    link: Any,
    session: zenoh.Session,
    stop: threading.Event,
) -> int:
    from pipelines.controller.controller import Controller
    from pipelines.controller.progress import Progress
    from pipelines.controller.trace import Trace

    moment = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    file = Home.current().traces / f"{moment}-{job.task}-{link.cell}-{uuid.uuid4().hex[:6]}.jsonl"
    with ExitStack() as stack:
        trace = stack.enter_context(Trace(file, tell_of))
        progress = stack.enter_context(Progress(session, link.cell, job.name, job.digest, stop))
        trace.write("run", cell=link.cell, tree=job.name, digest=job.digest)
        if arguments.watch:
            console.emit({"ready": True})
        tell = console.emit if arguments.watch else None
        result = Controller(job.root, link, trace, tell, progress).run(stop, arguments.timeout, arguments.watch)
    return _told(console, job, result, file)


def tell_of(event: str, facts: Mapping[str, Any]) -> None:
    """What a run is doing after an event of its trace, where that changes it."""
    from learner.progress import tell

    if event == "start":
        tell(f"{facts['action']}")
    elif event == "answer" and facts["status"] != "success":
        tell(f"going on after a failure: {facts['reason']}")
    elif event in ("answer", "halt", "disturbed"):
        tell("looking at what came of it" if event == "answer" else "looking for what to do now")
    elif event == "success":
        tell("watching: the goal holds")


def _told(console: Console, job: Job, result: RunResult, trace: Path) -> int:
    console.emit({**asdict(result), "trace": str(trace)})
    console.say(f"{job.name}: {result.outcome} after {result.actions} actions, {result.ticks} ticks; trace {trace}")
    if result.outcome == "success":
        return 0
    console.fail(CommandError(f"{job.name} ended with {result.outcome}: {result.reason}"))
    return 1
