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
    from pipelines.steps.ingest import Harvest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright ingest`."""
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE", help="recordings, or folders of them")


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 1 if any recording was quarantined, after doing the rest."""
    from pipelines.steps.ingest import ingest
    from pipelines.steps.stores import open_lake

    home = Home.current()
    harvest = ingest(home, open_lake(home), arguments.files)
    console.emit(harvest.to_data())
    _tell(harvest, console)
    if harvest.quarantined:
        console.warn(_summary(harvest))
    return 1 if harvest.quarantined else 0


def _tell(harvest: Harvest, console: Console) -> None:
    from learner.observation import warnings_of
    from pipelines.steps.ingest import doubts_about

    for demonstration in harvest.ingested:
        what = f"{demonstration.task} by {demonstration.user}, {len(demonstration.actions)} actions"
        console.say(f"ingested {demonstration.demonstration_id}: {what}, {demonstration.outcome}")
        for warning in (*warnings_of(demonstration), *demonstration.gaps, *doubts_about(demonstration)):
            console.say(f"  warning: {warning}")
    for waiting in harvest.waiting:
        parts = ", ".join(map(str, waiting.parts))
        console.say(f"waiting for the other parts of {waiting.demonstration_id}; there are: {parts}")
    for refused in harvest.quarantined:
        console.say(f"quarantined {refused.file}: {refused.reason}")
    console.say(f"{len(harvest.ingested)} ingested, {len(harvest.known)} known, {len(harvest.quarantined)} quarantined")
    for task in harvest.tasks:
        console.say(f"learn from it with: treewright learn {task}")


def _summary(harvest: Harvest) -> str:
    first, more = harvest.quarantined[0], len(harvest.quarantined) - 1
    others = f" (and {more} more)" if more else ""
    return f"quarantined {first.file}: {first.reason}{others}"
