"""One Delta table: opened, appended to and read, with the failures of a disk told as ours.

Appends are optimistic: each names marks of the table with the numbers that it sets them to, `{mark: number}`, from 1,
and of two writers that set one to the same number, the second fails and must look again. Marks are Delta's application
transactions; there are only a few, for the log carries each of them for ever.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
from deltalake import CommitProperties, DeltaTable, Transaction, WriterProperties, write_deltalake
from deltalake.exceptions import CommitFailedError, DeltaError, TableNotFoundError
from pyarrow.fs import LocalFileSystem, SubTreeFileSystem

from storage.errors import StorageUnavailableError

Filter = tuple[str, str, Any]
Filters = Sequence[Filter] | Sequence[Sequence[Filter]]
"""All of them, or of several such lists any."""

ROW_GROUP_ROWS: Final = 131_072
"""Tiny row groups make reading many times slower."""
FILES_BEFORE_COMPACTION: Final = 40
WRITER: Final = WriterProperties(compression="ZSTD", max_row_group_size=ROW_GROUP_ROWS)


class LostRaceError(Exception):
    """Another writer committed one of the same transactions first: look again. Never leaves storage."""


class Table:
    """A Delta table of `schema` in the folder `path`, which is created by the first append.

    `order` names the columns by which a compaction sorts, so that what is read together lies together.
    """

    def __init__(self, path: Path, schema: pa.Schema, order: Sequence[str]) -> None:
        self.path, self.schema, self.order = path, schema, list(order)

    def read(self, columns: Sequence[str] | None = None, filters: Filters | None = None) -> pa.Table:
        """The rows that pass all `filters`; none if nothing was ever appended. Raises StorageUnavailableError."""
        with self._failures():
            table = self._open()
            wanted = list(columns) if columns else self.schema.names
            if table is None:
                return self.schema.empty_table().select(wanted)
            # Not through deltalake's own file system, which is Python: one of Arrow's threads may still close a file
            # there when the interpreter ends, and then the whole process aborts.
            local = SubTreeFileSystem(str(self.path), LocalFileSystem())
            return table.to_pyarrow_table(columns=wanted, filesystem=local, filters=filters or None)

    def distinct(self, columns: Sequence[str]) -> set[tuple[Any, ...]]:
        """The different values of the rows in some columns."""
        found = self.read(columns).group_by(list(columns)).aggregate([])
        return set(zip(*(found[column].to_pylist() for column in columns), strict=True))

    def mark(self, name: str) -> int:
        """The number of a mark; 0 if it was never set."""
        with self._failures():
            table = self._open()
            return (table.transaction_version(name) or 0) if table else 0

    def append(self, rows: pa.Table, marks: Mapping[str, int]) -> None:
        """Append `rows` in one commit, whole or not at all.

        Raises LostRaceError if one of the `marks` has its number, or a later one, already; StorageUnavailableError if
        the folder cannot be written.
        """
        with self._failures():
            table = self._open() or self._create()
            for name, number in marks.items():
                if (table.transaction_version(name) or 0) >= number:
                    raise LostRaceError(name)
            transactions = [Transaction(name, number) for name, number in marks.items()]
            try:
                write_deltalake(
                    table,
                    rows.sort_by([(column, "ascending") for column in self.order]),
                    mode="append",
                    writer_properties=WRITER,
                    commit_properties=CommitProperties(app_transactions=transactions),
                )
            except CommitFailedError as error:
                raise LostRaceError(str(error)) from error
            self._compact_if_scattered()

    def files(self) -> list[str]:
        """Where the newest version's data lies."""
        with self._failures():
            table = self._open()
            return table.file_uris() if table else []

    def compact(self) -> None:
        """Rewrite many small files as few sorted ones. Readers keep the version that they opened."""
        with self._failures():
            if table := self._open():
                table.optimize.z_order(self.order, writer_properties=WRITER)
                table.vacuum(dry_run=False)

    def _compact_if_scattered(self) -> None:
        if len(self.files()) > FILES_BEFORE_COMPACTION:
            try:
                self.compact()
            except StorageUnavailableError:
                # What was appended is committed; the next append tries again.
                return

    def _open(self) -> DeltaTable | None:
        try:
            return DeltaTable(self.path)
        except TableNotFoundError:
            return None

    def _create(self) -> DeltaTable:
        self.path.mkdir(parents=True, exist_ok=True)
        try:
            return DeltaTable.create(self.path, self.schema, mode="ignore")
        except CommitFailedError as error:
            raise LostRaceError(str(error)) from error

    @contextmanager
    def _failures(self) -> Iterator[None]:
        try:
            yield
        except (DeltaError, OSError, pa.ArrowException) as error:
            reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
            raise StorageUnavailableError(f"the lake's table {self.path} cannot be used: {reason}") from error
