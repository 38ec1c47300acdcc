"""The flow that is asked for everything: ingest what is new, then learn every task of which something changed."""

from __future__ import annotations

from pathlib import Path

from prefect import flow, task

from pipelines.flows.ingest import ingest_flow
from pipelines.flows.learn import learn_flow
from pipelines.flows.patience import PATIENT
from pipelines.flows.relearn import relearn
from pipelines.home import Home
from pipelines.steps.changes import changed_tasks
from pipelines.steps.stores import open_lake


@flow(name="refresh", validate_parameters=False)
def refresh_flow(root: str) -> dict[str, str]:
    """For each task that was learned anew what came of it, in a sentence."""
    ingest_flow(root)
    return {name: learn_changed(root, name) for name in find_changes(root)}


@task(name="find what changed", **PATIENT)
def find_changes(root: str) -> list[str]:
    """The tasks that stand otherwise than when they were last learned."""
    home = Home(Path(root))
    return list(changed_tasks(home, open_lake(home)))


def learn_changed(root: str, name: str) -> str:
    """One task, in a flow of its own."""
    return relearn(Home(Path(root)), name, lambda: learn_flow(root, name))
