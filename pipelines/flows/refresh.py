"""The flow that is scheduled: ingest what is new, then learn every task of which something changed."""

from __future__ import annotations

from pathlib import Path

from prefect import flow, task

from learner.errors import LearnerError
from pipelines.errors import CommandError, UnreachableError
from pipelines.flows.ingest import ingest_flow
from pipelines.flows.learn import learn_flow
from pipelines.flows.patience import PATIENT
from pipelines.home import Home
from pipelines.steps.changes import TaskState, changed_tasks, remember
from pipelines.steps.stores import open_lake


@flow(name="refresh", validate_parameters=False)
def refresh_flow(root: str) -> dict[str, str]:
    """For each task that was learned anew what came of it, in a sentence."""
    ingest_flow(root)
    return {name: _learned(root, name, standing) for name, standing in find_changes(root).items()}


@task(name="find what changed", **PATIENT)
def find_changes(root: str) -> dict[str, TaskState]:
    """The tasks that stand otherwise than when they were last learned."""
    home = Home(Path(root))
    return changed_tasks(home, open_lake(home))


def _learned(root: str, name: str, standing: TaskState) -> str:
    """Learn one task. What will not pass is remembered until the task's demonstrations change; what may, is raised."""
    try:
        publication = learn_flow(root, name)
        result = f"version {publication.version}, {publication.nodes} nodes"
    except UnreachableError:
        raise
    except (LearnerError, CommandError) as error:
        result = f"nothing learned: {error}"
    remember(Home(Path(root)), name, standing.with_result(result))
    return result
