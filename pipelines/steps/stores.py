"""The lake and the artifact store of a data root, opened where a process begins and handed down."""

from __future__ import annotations

import os
from collections.abc import Mapping

from pipelines.home import Home
from storage.artifacts import ArtifactStore
from storage.lake import Lake


def open_lake(home: Home) -> Lake:
    """The lake of a data root; nothing is created before something is added."""
    return Lake(home.lake)


def open_store(home: Home, environment: Mapping[str, str] = os.environ) -> ArtifactStore:
    """The artifact store of a data root, its database elsewhere if TREEWRIGHT_STORE_URL says so; to be closed."""
    return ArtifactStore(home.store, environment.get("TREEWRIGHT_STORE_URL") or None)
