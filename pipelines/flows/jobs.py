"""What the warm processes do, each in a flow if it may, and without one where Prefect fails.

What our own parts refuse is no failure of Prefect's and is raised. Anything else is done once more without a flow: it
passes if it was Prefect's, and is raised if it was not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Final, TypeVar

from pipelines.console import silent_standard_error
from pipelines.errors import CommandError
from pipelines.flows.log import LOG
from pipelines.flows.relearn import relearn
from pipelines.home import Home
from pipelines.steps.ingest import IngestResult, ingest
from pipelines.steps.learn import Publication, learn_task
from pipelines.steps.stores import open_lake, open_store

Result = TypeVar("Result")


NEEDED: Final = ("pipelines.flows.jobs", "pipelines.flows.refresh", "learner.simulation.physical_world")
"""What the jobs import when they run."""


def warm_up() -> str:
    """Import what the other jobs need, where that is not done."""
    with silent_standard_error():
        for module in NEEDED:
            import_module(module)
    return "warm"


def ingest_files(root: str, files: Sequence[str], in_flow: bool) -> str:
    """Ingest these files, or whatever is new; what came of it, in a sentence."""
    home = Home(Path(root))

    def flow() -> IngestResult:
        from pipelines.flows.ingest import ingest_flow

        return ingest_flow(root, files)

    def plainly() -> IngestResult:
        return ingest(home, open_lake(home), [Path(file) for file in files])

    return in_flow_or_without(flow, plainly, in_flow).sentence


def learn_changed_task(root: str, task: str, in_flow: bool) -> str:
    """Learn a task of which something changed; what came of it, in a sentence."""
    home = Home(Path(root))

    def flow() -> Publication:
        from pipelines.flows.learn import learn_flow

        return learn_flow(root, task)

    def plainly() -> Publication:
        with open_store(home) as store:
            return learn_task(open_lake(home), store, task)

    return relearn(home, task, lambda: in_flow_or_without(flow, plainly, in_flow))


def in_flow_or_without(flow: Callable[[], Result], plainly: Callable[[], Result], in_flow: bool) -> Result:
    """What the flow returns or, where it may not run or fails by no doing of ours, what is done without it."""
    if not in_flow:
        return plainly()
    try:
        return flow()
    except Exception as error:
        if CommandError.covers(error) and not isinstance(error, OSError):
            raise
        LOG.warning("the flow failed (%s: %s); it is done without one", type(error).__name__, error)
        return plainly()
