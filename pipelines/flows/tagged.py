"""Tags of a flow run that are known only once it runs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from prefect import get_client
from prefect.runtime import flow_run

MOST: Final = 50
"""A run of very many users is not found by each of them."""


def tag_run(names: Iterable[str]) -> None:
    """Add tags to the flow run that this is called in."""
    found = list(names)[:MOST]
    if not found:
        return
    with get_client(sync_client=True) as client:
        client.update_flow_run(flow_run.id, tags={*flow_run.tags, *found})
