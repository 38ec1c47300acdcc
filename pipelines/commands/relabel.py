"""`treewright relabel ID STEP TYPE`: correct the type of a demonstrated action.

A place becomes a drop, or the reverse; what the operator had pressed is kept beside. In a demonstration in quarantine
an action becomes whatever was meant, and the demonstration is judged again. With --json: {"demonstration_id", "step",
"type", "demonstrated_type", "changed"}, of one in quarantine with "quarantined": why it stays there, else null.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from pipelines.console import Console
from pipelines.home import Home
from pipelines.options import INDEX

if TYPE_CHECKING:
    from pipelines.steps.quarantine import QuarantinedDemonstration
    from storage.lake import Lake


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright relabel`."""
    parser.add_argument("id", metavar="ID", help="id of the demonstration")
    parser.add_argument(
        "step", metavar="STEP", type=INDEX, help="number of the action, as `treewright demos show` tells"
    )
    parser.add_argument("type", metavar="TYPE", choices=("pick", "place", "drop"), help="what was meant")


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0; what fails raises."""
    from pipelines.steps.quarantine import find_quarantined
    from pipelines.steps.stores import open_lake

    home = Home.current()
    lake = open_lake(home)
    known = arguments.id in lake.known().values()
    found = None if known else find_quarantined(home, lake, arguments.id)
    if found is not None:
        return _relabel_quarantined(lake, found, arguments, console)
    changed = lake.relabel(arguments.id, arguments.step, arguments.type)
    demonstrated = lake.entry(arguments.id).demonstrated_types.get(arguments.step, arguments.type)
    said = "is now" if changed else "was already"
    console.say(f"step {arguments.step} of {arguments.id} {said} a {arguments.type}; it was shown as a {demonstrated}")
    document = {"demonstration_id": arguments.id, "step": arguments.step, "type": arguments.type}
    console.emit(document | {"demonstrated_type": demonstrated, "changed": changed})
    return 0


def _relabel_quarantined(
    lake: Lake, found: QuarantinedDemonstration, arguments: argparse.Namespace, console: Console
) -> int:
    from pipelines.commands.demos import judge_again
    from pipelines.steps.quarantine import pressed_type

    left = judge_again(lake, found, [arguments.step], arguments.type, console)
    pressed = pressed_type(found, arguments.step)
    console.say(f"step {arguments.step} of {arguments.id} is now a {arguments.type}; it was shown as a {pressed}")
    document = {"demonstration_id": arguments.id, "step": arguments.step, "type": arguments.type}
    console.emit(document | {"demonstrated_type": pressed, "changed": True, "quarantined": left})
    return 0
