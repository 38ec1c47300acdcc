"""The process that runs the deployed flows: `python -m pipelines.flows.deployments ROOT PERIOD_S`.

The refresh runs on a schedule; ingest and learn wait to be asked for in Prefect's pages. One run at a time.
"""

from __future__ import annotations

import sys
from datetime import timedelta
from pathlib import Path
from typing import Any, Final

from prefect import Flow, serve
from prefect.deployments.runner import RunnerDeployment
from prefect.types.entrypoint import EntrypointType

from pipelines.flows.ingest import ingest_flow
from pipelines.flows.learn import learn_flow
from pipelines.flows.refresh import refresh_flow
from pipelines.home import Home
from pipelines.service.prefect_server import deployment_name

POLL_S: Final = 2.0


def serve_flows(home: Home, period_s: float) -> None:
    """Deploy the flows for a data root and run what is scheduled, until SIGINT or SIGTERM."""
    serve(
        _deployed(refresh_flow, home, interval=timedelta(seconds=period_s)),
        _deployed(ingest_flow, home),
        _deployed(learn_flow, home),
        limit=1,
        print_starting_message=False,
        query_seconds=POLL_S,
    )


def _deployed(flow: Flow[..., Any], home: Home, **schedule: Any) -> RunnerDeployment:
    deployment = flow.to_deployment(
        deployment_name(home),
        parameters={"root": str(home.root)},
        paused=False,
        # By file path Prefect would import a second copy of our classes.
        entrypoint_type=EntrypointType.MODULE_PATH,
        **schedule,
    )
    assert isinstance(deployment, RunnerDeployment)  # a coroutine only within an event loop
    return deployment


if __name__ == "__main__":
    serve_flows(Home(Path(sys.argv[1])), float(sys.argv[2]))
