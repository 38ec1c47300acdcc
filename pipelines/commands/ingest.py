"""`treewright ingest [FILE…]`: MCAP to the lake, without FILE whatever is new; exits 1 if any was quarantined.

With --json: {"ingested": [id], "known": [id], "quarantined": [{"file", "reason"}]}, and "waiting"
[{"demonstration_id", "parts"}] where a split demonstration lacks a part, and "doubts" {id: [sentence]} where a label
does not seem to fit what was seen.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.console import Console
from pipelines.home import Home

if TYPE_CHECKING:
    from pipelines.steps.ingest import IngestResult


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright ingest`."""
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="recordings, or folders of them")


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 1 if any recording was quarantined, after doing the rest."""
    from pipelines.progress import progress
    from pipelines.steps.ingest import ingest
    from pipelines.steps.stores import open_lake

    home = Home.current()
    with progress(console, "looking for recordings"):
        result = ingest(home, open_lake(home), arguments.files)
    console.emit(result.to_data())
    _tell(result, console)
    if result.quarantined:
        console.warn(_summary(result))
    return 1 if result.quarantined else 0


def _tell(result: IngestResult, console: Console) -> None:
    for each in result.ingested:
        what = f"{each.task} by {each.user}, {each.actions} actions"
        console.say(f"ingested {each.demonstration_id}: {what}, {each.outcome}")
        for warning in (*each.warnings, *each.doubts):
            console.say(f"  warning: {warning}")
    for waiting in result.waiting:
        parts = ", ".join(map(str, waiting.parts))
        console.say(f"waiting for the other parts of {waiting.demonstration_id}; there are: {parts}")
    for refused in result.quarantined:
        console.say(str(refused))
    console.say(result.sentence)
    for task in result.tasks:
        console.say(f"learn from it with: treewright learn {task}")


def _summary(result: IngestResult) -> str:
    first, more = result.quarantined[0], len(result.quarantined) - 1
    others = f" (and {more} more)" if more else ""
    return f"{first}{others}"
