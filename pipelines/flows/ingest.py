"""The flow that ingests: recordings to the lake or to quarantine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prefect import flow, get_run_logger, task
from prefect.runtime import flow_run

from pipelines.flows.patience import PATIENT
from pipelines.flows.shown import show_ingested
from pipelines.flows.tagged import tag_run
from pipelines.flows.worker import tell_news
from pipelines.home import Home
from pipelines.steps.ingest import IngestResult, ingest
from pipelines.steps.stores import open_lake


def _run_name() -> str:
    files = flow_run.parameters.get("files") or ()
    return f"ingest {Path(files[0]).name}{' and more' if len(files) > 1 else ''}" if files else "ingest what is new"


@flow(name="ingest", flow_run_name=_run_name, validate_parameters=False)
def ingest_flow(root: str, files: Sequence[str] = ()) -> IngestResult:
    """Ingest `files`, or whatever is new below the data root."""
    result = ingest_recordings(root, files)
    # What is in the lake can be learned from while the rest is shown.
    tell_news()
    tag_run(tags_of(result))
    show_ingested(result)
    return result


def tags_of(result: IngestResult) -> list[str]:
    """By what a run is found: tasks, cells and users of what was new."""
    new = result.ingested
    facts = [(f"task:{each.task}", f"cell:{each.cell}", f"user:{each.user}") for each in new]
    return sorted({tag for each in facts for tag in each}) + (["quarantine"] if result.quarantined else [])


@task(name="ingest recordings", **PATIENT)
def ingest_recordings(root: str, files: Sequence[str]) -> IngestResult:
    """The plain function on a data root."""
    home = Home(Path(root))
    result = ingest(home, open_lake(home), [Path(file) for file in files])
    get_run_logger().info(result.sentence)
    return result
