"""`treewright learn TASK`: cluster, infer, plan, verify, publish, set alias `latest`, or `doubtful` with the reasons.

With --json: {"task", "version", "digest", "nodes", "nodes_recovery", "aliases", "notes", "doubts", "doubtful", "new"}.
Where PREFECT_API_URL is set the flow runs and is seen there; else the same functions run directly. On a terminal a line
says each second what is being done.
"""

from __future__ import annotations

import argparse
import os
from typing import TYPE_CHECKING, Final

from pipelines.console import Console
from pipelines.home import Home

if TYPE_CHECKING:
    from pipelines.steps.learn import Publication

METHODS: Final = ("treewright", "paper")
"""Those of `learner.learning`, which the help names without loading it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright learn`."""
    parser.add_argument("task", metavar="TASK")
    parser.add_argument(
        "--method", choices=METHODS, metavar="NAME", help=f"{' (default) or '.join(METHODS)}, the published one"
    )
    parser.add_argument("--include-unknown", action="store_true", help="learn from outcomes other than success too")
    parser.add_argument("--include-gaps", action="store_true", help="also where messages were lost near an action")


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0; what fails raises."""
    from pipelines.progress import progress

    with progress(console, f"learning {arguments.task}"):
        publication = _learn(arguments)
    console.emit(publication.to_data())
    console.say(_summary(publication))
    for note in publication.notes:
        console.say(f"  note: {note}")
    for reason in publication.doubtful:
        console.say(f"  doubtful: {reason}")
    return 0


def _learn(arguments: argparse.Namespace) -> Publication:
    from learner.learning import DEFAULT_METHOD

    home, method = Home.current(), arguments.method or DEFAULT_METHOD
    if os.environ.get("PREFECT_API_URL"):
        from pipelines.service.prefect_server import run_in_this_process

        run_in_this_process()
        from pipelines.flows.learn import learn_flow

        return learn_flow(str(home.root), arguments.task, method, arguments.include_unknown, arguments.include_gaps)
    from pipelines.steps.learn import learn_task, learning
    from pipelines.steps.stores import open_lake, open_store

    with learning(home, arguments.task), open_store(home) as store:
        return learn_task(
            open_lake(home), store, arguments.task, method, arguments.include_unknown, arguments.include_gaps
        )


def _summary(publication: Publication) -> str:
    recovery = f" and {publication.nodes_recovery} that only recover" if publication.nodes_recovery else ""
    what = "learned" if publication.new else "nothing new: this tree was there already as"
    name = f"{publication.task}@{publication.version} ({', '.join(publication.aliases) or 'no alias'})"
    return f"{what} {name}: {publication.nodes} nodes{recovery}"
