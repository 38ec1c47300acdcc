"""Where all data lies: the folders below TREEWRIGHT_HOME (CONTRACT, section 4)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

TOKEN: Final = "TREEWRIGHT_TOKEN"
"""Names the variable with the token by which a service takes recordings from elsewhere."""


@dataclass(frozen=True)
class Home:
    """The data root and the folders in it."""

    root: Path

    @staticmethod
    def of(environment: Mapping[str, str]) -> Home:
        """The data root that the environment names, else `./treewright-data`; absolute."""
        return Home(Path(environment.get("TREEWRIGHT_HOME") or "treewright-data").absolute())

    @staticmethod
    def current() -> Home:
        """The data root of this process."""
        return Home.of(os.environ)

    @property
    def recordings(self) -> Path:
        """Finished MCAP files, `<cell>/<demonstration_id>.mcap`; open ones end in `.mcap.part` beside them."""
        return self.root / "recordings"

    @property
    def arriving(self) -> Path:
        """Recordings that are on their way here, `<sha256>.part`, and which have arrived, `<sha256>.json`.

        On the disk of the recordings, so that what is whole takes its place at once; no cell has such a name.
        """
        return self.recordings / ".arriving"

    @property
    def cells(self) -> Path:
        """What stands in each cell, `<cell>.yaml`: profiles that people write."""
        return self.root / "cells"

    @property
    def lake(self) -> Path:
        """The Delta tables of demonstrations, and the quarantine's records."""
        return self.root / "lake"

    @property
    def quarantine(self) -> Path:
        """Copies of refused recordings that came from elsewhere, `<sha256>.mcap`."""
        return self.root / "quarantine"

    @property
    def store(self) -> Path:
        """The artifact store: its SQLite database and content-addressed files."""
        return self.root / "store"

    @property
    def learned(self) -> Path:
        """What the scheduled refresh learned from what, JSON by task."""
        return self.root / "learned.json"

    def lock(self, name: str) -> Path:
        """The file by which processes of this machine exclude each other from what the name says."""
        return self.root / "locks" / f"{name}.lock"

    @property
    def traces(self) -> Path:
        """What controllers did, one JSON Lines file a run."""
        return self.root / "traces"

    @property
    def tokens(self) -> Path:
        """Who may use the panel from other machines; hashes, no secrets."""
        return self.root / "tokens.json"

    @property
    def logs(self) -> Path:
        """What the processes say that `serve` and `demo` start."""
        return self.root / "logs"

    @property
    def prefect(self) -> Path:
        """PREFECT_HOME of a server that treewright starts."""
        return self.root / "prefect"
