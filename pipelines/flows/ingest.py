"""The flow that ingests: recordings to the lake or to quarantine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prefect import flow, task

from pipelines.flows.patience import PATIENT
from pipelines.flows.shown import show_ingested
from pipelines.home import Home
from pipelines.steps.ingest import IngestResult, ingest
from pipelines.steps.stores import open_lake


@flow(name="ingest", validate_parameters=False)
def ingest_flow(root: str, files: Sequence[str] = ()) -> IngestResult:
    """Ingest `files`, or whatever is new below the data root."""
    result = ingest_recordings(root, files)
    show_ingested(result)
    return result


@task(name="ingest recordings", **PATIENT)
def ingest_recordings(root: str, files: Sequence[str]) -> IngestResult:
    """The plain function on a data root."""
    home = Home(Path(root))
    return ingest(home, open_lake(home), [Path(file) for file in files])
