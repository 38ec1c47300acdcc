"""The recordings that were judged, each with its file as it was then: what did not change is not read again.

One row a judgement, the newest on a file counts. The table is a memory and no more: where it is gone, every file is
read once and found known by its digest.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import pyarrow as pa

from storage.table import Table

JUDGED: Final = pa.schema(
    [
        ("file", pa.string()),
        ("size_bytes", pa.int64()),
        ("modified_ns", pa.int64()),
        ("changed_ns", pa.int64()),
        ("sha256", pa.string()),
        ("demonstration_id", pa.string()),
        ("judged_ns", pa.int64()),
    ]
)
FEW: Final = 1000
"""So many names are asked for one by one; for more of them the whole table is read."""


@dataclass(frozen=True)
class FileState:
    """What tells a file that was changed from one that was not, without reading it: size, and the times [ns] of the
    last change of its bytes (mtime) and of anything about it (ctime).
    """

    size_bytes: int
    modified_ns: int
    changed_ns: int

    @staticmethod
    def of(path: Path) -> FileState:
        """The state of a file now. Raises OSError."""
        found = path.stat()
        return FileState(found.st_size, found.st_mtime_ns, found.st_ctime_ns)


@dataclass(frozen=True)
class Judged:
    """What became of a recording: the demonstration in the lake, or None where it was refused.

    `sha256` is the digest of what was judged: of a part of a split demonstration, that of all parts;
    of what could not be read, None.
    """

    file: str
    state: FileState
    sha256: str | None
    demonstration_id: str | None
    judged_ns: int = 0


class JudgedFiles:
    """The table of them in the folder `path`."""

    def __init__(self, path: Path) -> None:
        self.table = Table(path, JUDGED, ("file",))

    def of(self, files: Collection[str]) -> dict[str, Judged]:
        """The newest judgement of each of these files that was ever judged."""
        filters = [("file", "in", sorted(files))] if len(files) <= FEW else None
        rows = self.table.read(filters=filters).sort_by("judged_ns").to_pylist() if files else []
        return {row["file"]: _read(row) for row in rows}

    def note(self, judged: Iterable[Judged]) -> None:
        """Remember judgements, in one commit."""
        now_ns = time.time_ns()
        rows = [_row(replace(each, judged_ns=now_ns)) for each in judged]
        if rows:
            self.table.append(pa.Table.from_pylist(rows, JUDGED), {})


def _row(judged: Judged) -> dict[str, object]:
    row = asdict(judged)
    return {**row.pop("state"), **row}


def _read(row: dict[str, object]) -> Judged:
    state: Sequence[object] = [row.pop(name) for name in ("size_bytes", "modified_ns", "changed_ns")]
    return Judged(state=FileState(*state), **row)  # type: ignore[arg-type]  # as the schema has them
