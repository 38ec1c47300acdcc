"""The deployed flows: what can be asked for in Prefect's pages, each run in a process of its own."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from prefect import Flow, get_client, serve
from prefect.client.schemas.filters import DeploymentFilter, DeploymentFilterName
from prefect.client.schemas.responses import DeploymentResponse
from prefect.deployments.runner import RunnerDeployment
from prefect.types.entrypoint import EntrypointType

from pipelines.flows.ingest import ingest_flow
from pipelines.flows.learn import learn_flow
from pipelines.flows.log import LOG
from pipelines.flows.refresh import refresh_flow
from pipelines.home import Home
from pipelines.service.prefect_server import DEPLOYED, LOOPBACK, deployment_name, is_ready

POLL_S: Final = 2.0
AT_ONCE: Final = 4
HOST_TAG: Final = f"host:{socket.gethostname()}"


def serve_flows(home: Home) -> None:
    """Deploy the flows for a data root and run what is asked for, until SIGINT or SIGTERM; again, where the server was
    gone for a while.
    """
    while True:
        while not is_ready(os.environ["PREFECT_API_URL"]):
            time.sleep(POLL_S)
        try:
            remove_stale(home)
            _serve(home)
        except Exception:  # noqa: BLE001  # Prefect raises whatever its HTTP client does
            # Prefect gives up when its server is gone; it comes back.
            LOG.exception("the deployed flows are not served")
            time.sleep(POLL_S)
        else:
            return


def remove_stale(home: Home) -> None:
    """Remove the deployments of data roots that are no more, such as one that was renamed, and those of this one that
    an earlier treewright scheduled: all that was missed while nobody served it would run at once.
    """
    ours = DeploymentFilter(name=DeploymentFilterName(like_=DEPLOYED))
    with get_client(sync_client=True) as client:
        for deployment in client.read_deployments(deployment_filter=ours):
            if _is_stale(deployment, home):
                LOG.info("removing the deployment %s of %s", deployment.name, _root(deployment))
                client.delete_deployment(deployment.id)


def _is_stale(deployment: DeploymentResponse, home: Home) -> bool:
    root = _root(deployment)
    if root is None:
        return False
    if root == home.root:
        return bool(deployment.schedules)
    return _is_on_this_host(deployment) and not root.exists()


def _is_on_this_host(deployment: DeploymentResponse) -> bool:
    """Several machines may share a server; one that answers on this machine alone is shared by none."""
    return HOST_TAG in deployment.tags or urlsplit(os.environ["PREFECT_API_URL"]).hostname in LOOPBACK


def _root(deployment: DeploymentResponse) -> Path | None:
    root = (deployment.parameters or {}).get("root")
    return Path(root) if isinstance(root, str) and deployment.name.startswith(DEPLOYED) else None


def _serve(home: Home) -> None:
    serve(
        *(_deployed(flow, home) for flow in (refresh_flow, ingest_flow, learn_flow)),
        limit=AT_ONCE,
        print_starting_message=False,
        query_seconds=POLL_S,
    )


def _deployed(flow: Flow[..., Any], home: Home) -> RunnerDeployment:
    deployment = flow.to_deployment(
        deployment_name(home),
        parameters={"root": str(home.root)},
        tags=[HOST_TAG],
        paused=False,
        # By file path Prefect would import a second copy of our classes.
        entrypoint_type=EntrypointType.MODULE_PATH,
    )
    assert isinstance(deployment, RunnerDeployment)  # a coroutine only within an event loop
    return deployment
