"""`treewright relabel ID STEP TYPE`: correct the type of a demonstrated action.

A place becomes a drop, or the reverse; what the operator had pressed is kept beside. With --json: {"demonstration_id",
"step", "type", "demonstrated_type", "changed"}.
"""

from __future__ import annotations

import argparse

from pipelines.commands.options import INDEX
from pipelines.console import Console
from pipelines.home import Home


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright relabel`."""
    parser.add_argument("id", metavar="ID", help="id of the demonstration")
    parser.add_argument(
        "step", metavar="STEP", type=INDEX, help="number of the action, as `treewright demos show` tells"
    )
    parser.add_argument("type", metavar="TYPE", choices=("pick", "place", "drop"), help="place or drop")


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0; what fails raises."""
    from pipelines.steps.stores import open_lake

    lake = open_lake(Home.current())
    changed = lake.relabel(arguments.id, arguments.step, arguments.type)
    demonstrated = lake.entry(arguments.id).demonstrated_types.get(arguments.step, arguments.type)
    said = "is now" if changed else "was already"
    console.say(f"step {arguments.step} of {arguments.id} {said} a {arguments.type}; it was shown as a {demonstrated}")
    document = {"demonstration_id": arguments.id, "step": arguments.step, "type": arguments.type}
    console.emit(document | {"demonstrated_type": demonstrated, "changed": changed})
    return 0
