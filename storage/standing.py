"""Whether a version may be used: what is doubted of it, and who took that on (CONTRACT, section 3).

A version is a tree and stays as it was published; what is known of it changes, with each time that the same tree is
learned again and with each approval. All functions work within a transaction of the caller.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from storage.schema import APPROVALS, STANDINGS


@dataclass(frozen=True)
class Standing:
    """The sentences on which a version is `doubtful`, none once all are approved, and by whom and when any were.

    `chosen_ns` is when the demonstrations were chosen from which it was learned last; None where that is not known.
    """

    doubtful: tuple[str, ...] = ()
    approved: tuple[dict[str, Any], ...] = ()
    chosen_ns: int | None = None

    def to_data(self) -> dict[str, Any]:
        """What is served beside the manifest."""
        return {"doubtful": list(self.doubtful), "approved": [dict(each) for each in self.approved]}


def standing_of(connection: sa.Connection, task: str, version: int) -> Standing:
    """The standing of a version; of one that nobody judged nothing is doubted."""
    judged = connection.execute(_of(STANDINGS, task, version)).one_or_none()
    rows = connection.execute(_of(APPROVALS, task, version).order_by(APPROVALS.c.serial)).all()
    taken_on = {sentence for row in rows for sentence in json.loads(row.reasons)}
    reasons = () if judged is None else tuple(r for r in json.loads(judged.reasons) if r not in taken_on)
    approved = tuple({"by": row.by, "stamp_ns": row.stamp_ns} for row in rows)
    return Standing(reasons, approved, None if judged is None else judged.chosen_ns)


def judge(connection: sa.Connection, task: str, version: int, reasons: Sequence[str], chosen_ns: int) -> None:
    """Write what is doubted of a version now, in place of what was."""
    where = (STANDINGS.c.task == task) & (STANDINGS.c.version == version)
    connection.execute(STANDINGS.delete().where(where))
    values = {"task": task, "version": version, "reasons": json.dumps(list(reasons)), "chosen_ns": chosen_ns}
    connection.execute(STANDINGS.insert().values(**values))


def approve(connection: sa.Connection, task: str, version: int, by: str, reasons: Sequence[str]) -> None:
    """Write that somebody took these doubts on."""
    values = {"task": task, "version": version, "by": by, "reasons": json.dumps(list(reasons))}
    connection.execute(APPROVALS.insert().values(stamp_ns=time.time_ns(), **values))


def _of(table: sa.Table, task: str, version: int) -> sa.Select[Any]:
    return sa.select(table).where(table.c.task == task, table.c.version == version)
