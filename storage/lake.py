"""The lake: every demonstration once, what was kept out and why, and what a person corrected.

    demonstrations   one row each; a row here is what makes a demonstration ingested
    actions          a row per action and frame, sorted by type, object and frame
    quarantine       recordings that were refused, with the reason
    corrections      exclusions, relabelled and taken back actions, beside the original, which never changes; also of
                     recordings in quarantine, which are judged by them again
    files            the recordings that were judged, as they were then (see storage.judged)

Every table is a Delta table and grows only. Any number of processes may read and write at once: what was decided by a
table as it stood is appended with the next number of a mark of that table, which one of two writers gets.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, get_args

import pyarrow as pa

from learner.model import DemonstratedAction, Demonstration
from learner.model.demonstration import ActionType
from storage.errors import ConflictError, NotStoredError, RelabelRefusedError, StorageUnavailableError
from storage.judged import JudgedFiles
from storage.rows import (
    ACTION_ORDER,
    ACTIONS,
    DEMONSTRATIONS,
    Row,
    action_rows,
    demonstration_rows,
    read_demonstrations,
)
from storage.table import LostRaceError, Table

Result = TypeVar("Result")
Files = Sequence[str | Path] | Mapping[str, Sequence[str | Path]]
CorrectionKind = Literal["exclude", "restore", "relabel", "undo"]

ATTEMPTS: Final = 50
"""How often a writer that lost a race looks again; each race has a winner, so this ends."""
DECIDED: Final = "decided"
"""The mark of a table that counts the decisions that were made by it."""
WRITTEN: Final = "written"
"""The mark of the actions' appends; in the demonstrations' table, up to which of them nothing is left over."""
KEY: Final = ("demonstration_id", "sha256")
RELEASES: Final[tuple[ActionType, ...]] = ("place", "drop")
QUARANTINE: Final = pa.schema(
    [("quarantined_ns", pa.int64()), ("file", pa.string()), ("sha256", pa.string()), ("reason", pa.string())]
)
CORRECTIONS: Final = pa.schema(
    [
        ("serial", pa.int64()),
        ("corrected_ns", pa.int64()),
        ("kind", pa.string()),
        ("demonstration_id", pa.string()),
        ("step", pa.int32()),
        ("type", pa.string()),
    ]
)


@dataclass(frozen=True)
class Quarantined:
    """A recording that was refused: `reason` is the sentence; `sha256` is None where it could not be read."""

    file: str
    sha256: str | None
    reason: str
    quarantined_ns: int = 0

    def says(self, other: Quarantined | None) -> bool:
        """Whether `other` says the same of the same bytes, whenever."""
        return other is not None and replace(self, quarantined_ns=other.quarantined_ns) == other


@dataclass(frozen=True)
class Entry:
    """A demonstration with a person's corrections made.

    `demonstrated_types` holds, by step, what the operator had pressed where a person relabelled it since; `taken_back`
    the steps that a person took back.
    """

    demonstration: Demonstration
    excluded: bool = False
    demonstrated_types: Mapping[int, ActionType] = field(default_factory=dict)
    taken_back: tuple[int, ...] = ()


@dataclass(frozen=True)
class Word:
    """What decides about learning from a demonstration without its content: that follows from the digest.

    `meant` holds, by step, what a person said that it was: a type, or 'undo'.
    """

    task: str
    demonstration_id: str
    sha256: str
    excluded: bool
    meant: Mapping[int, str]


class Lake:
    """The tables below `root`; nothing is created before something is added."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._demonstrations = Table(root / "demonstrations", DEMONSTRATIONS, ("task", "demonstration_id"))
        self._actions = Table(root / "actions", ACTIONS, ACTION_ORDER)
        self._quarantine = Table(root / "quarantine", QUARANTINE, ("quarantined_ns",))
        self._corrections = Table(root / "corrections", CORRECTIONS, ("serial",))
        self.files = JudgedFiles(root / "files")

    def add(self, demonstration: Demonstration, files: Sequence[str | Path] = ()) -> bool:
        """Ingest a demonstration, whole or not at all; `files` are the recordings that it came from.

        True if it is new, False if it was known. Raises ConflictError if its id is taken by other content.
        """
        return self.add_all([demonstration], files)[0]

    def add_all(self, demonstrations: Sequence[Demonstration], files: Files = ()) -> list[bool]:
        """Ingest many in one commit: for each whether it is new. With a ConflictError none is ingested.

        `files` are the recordings that all of them came from or, as a mapping, those of each by its id.
        """
        by_id = files if isinstance(files, Mapping) else {each.demonstration_id: files for each in demonstrations}
        names = {demonstration_id: [str(file) for file in paths] for demonstration_id, paths in by_id.items()}
        return _until_won(lambda: self._try_to_add(demonstrations, names))

    def demonstrations(self, task: str | None = None, include_excluded: bool = False) -> list[Demonstration]:
        """Those of `task`, or all, corrections made, in the order of their start (then id), whoever ingested when."""
        return [entry.demonstration for entry in self.entries(task) if include_excluded or not entry.excluded]

    def entries(self, task: str | None = None) -> list[Entry]:
        """All demonstrations of `task`, or all, excluded ones too, each with what was corrected."""
        filters = [] if task is None else [("task", "=", task)]
        headers = self._demonstrations.read(filters=filters)
        demonstrations = read_demonstrations(headers, self._actions.read(filters=filters))
        corrections = self._corrections_by_id()
        entries = [_corrected(each, corrections.get(each.demonstration_id, [])) for each in demonstrations]
        return sorted(entries, key=lambda entry: _start(entry.demonstration))

    def words(self) -> list[Word]:
        """A word on each demonstration, excluded ones too; no action is read."""
        corrections = self._corrections_by_id()
        rows = self._demonstrations.read(["task", "demonstration_id", "sha256"]).to_pylist()
        return [Word(**row, **_meant(corrections.get(row["demonstration_id"], ()))) for row in rows]

    def entry(self, demonstration_id: str) -> Entry:
        """One demonstration. Raises NotStoredError."""
        filters = [("demonstration_id", "=", demonstration_id)]
        found = read_demonstrations(self._demonstrations.read(filters=filters), self._actions.read(filters=filters))
        if not found:
            raise NotStoredError("demonstration", demonstration_id, sorted(self._digests()))
        return _corrected(found[0], self._corrections_by_id().get(demonstration_id, []))

    def known(self) -> dict[str, str]:
        """The id of each ingested demonstration by the digest of its recording."""
        return {sha256: demonstration_id for demonstration_id, sha256 in self._digests().items()}

    def stored(self, ids: Collection[str] = (), digests: Collection[str] = ()) -> dict[str, str]:
        """The digest by id of the demonstrations that have one of these ids, or are of one of these digests."""
        asked = (("demonstration_id", "in", sorted(ids)), ("sha256", "in", sorted(digests)))
        filters = [[each] for each in asked if each[2]]
        return _pairs(self._demonstrations.read(["demonstration_id", "sha256"], filters)) if filters else {}

    def quarantine(self, file: str | Path, sha256: str | None, reason: str) -> bool:
        """Record that a recording was refused. False if just this was recorded before."""
        return self.quarantine_all([Quarantined(str(file), sha256, reason)]) == 1

    def quarantine_all(self, refused: Sequence[Quarantined]) -> int:
        """Record in one commit that recordings were refused, now; of how many just this was not recorded before."""
        now_ns = time.time_ns()
        return _until_won(lambda: self._try_to_quarantine([replace(each, quarantined_ns=now_ns) for each in refused]))

    def quarantined(self) -> list[Quarantined]:
        """The recordings that stand refused, oldest first: the newest word on each, without those ingested since."""
        table = self._demonstrations.read(["files", "sha256", "ingested_ns"])
        rows = table.to_pylist()
        ingested = {row["sha256"] for row in rows}
        ingested_ns = {file: row["ingested_ns"] for row in rows for file in row["files"]}
        return [
            record
            for record in self._quarantine_records()
            if record.sha256 not in ingested and ingested_ns.get(record.file, 0) < record.quarantined_ns
        ]

    def exclude(self, demonstration_id: str) -> bool:
        """Leave a demonstration out of learning. False if it was left out already. Raises NotStoredError."""
        return _until_won(lambda: self._try_to_correct("exclude", demonstration_id))

    def restore(self, demonstration_id: str) -> bool:
        """Take an excluded demonstration back. False if it was not excluded. Raises NotStoredError."""
        return _until_won(lambda: self._try_to_correct("restore", demonstration_id))

    def relabel(self, demonstration_id: str, step: int, type: ActionType) -> bool:
        """Correct the type of an action; what was demonstrated stays beside. False if it has this type already.

        A place may become a drop and the reverse. Raises NotStoredError, and RelabelRefusedError for what the
        gripper contradicts: what closed it is a pick, what opened it is not.
        """
        return _until_won(lambda: self._try_to_relabel(demonstration_id, step, type))

    def undo(self, demonstration_id: str, steps: Sequence[int]) -> bool:
        """Take actions back; what was demonstrated stays beside. False if they were all taken back already.

        What is left has to be picks and releases in turn. Raises NotStoredError, and RelabelRefusedError.
        """
        return _until_won(lambda: self._try_to_undo(demonstration_id, steps))

    def correct_refused(self, demonstration_id: str, step: int, type: ActionType | Literal["undo"]) -> None:
        """Keep what a person says of an action in a recording that is in quarantine; 'undo' takes it back."""
        kind: CorrectionKind = "undo" if type == "undo" else "relabel"
        named = None if type == "undo" else type
        _until_won(lambda: self._correct(self._next_serial(), kind, demonstration_id, step, named))

    def corrections(self) -> dict[str, list[tuple[int, ActionType | Literal["undo"]]]]:
        """By demonstration, in quarantine too, each corrected step with its type or 'undo', oldest first."""
        return {
            name: [(row["step"], row["type"] or "undo") for row in rows if row["kind"] in ("relabel", "undo")]
            for name, rows in self._corrections_by_id().items()
        }

    def compact(self) -> None:
        """Rewrite the small files of many ingests as few sorted ones."""
        for table in (self._demonstrations, self._actions, self._quarantine, self._corrections, self.files.table):
            table.compact()

    def _try_to_add(self, demonstrations: Sequence[Demonstration], files: Mapping[str, Sequence[str]]) -> list[bool]:
        # In this order: of what is committed after it was looked at, a mark of ours is taken.
        followed, written = self._demonstrations.mark(WRITTEN), self._actions.mark(WRITTEN)
        decided = self._demonstrations.mark(DECIDED)
        digests = self.stored(ids={demonstration.demonstration_id for demonstration in demonstrations})
        new, answers = [], []
        for demonstration in demonstrations:
            stored = digests.setdefault(demonstration.demonstration_id, "")
            if stored not in ("", demonstration.sha256):
                raise ConflictError(demonstration.demonstration_id, demonstration.sha256, stored)
            if not stored:
                digests[demonstration.demonstration_id] = demonstration.sha256
                new.append(demonstration)
            answers.append(not stored)
        if new:
            marks = {DECIDED: decided + 1, **self._write_actions(new, followed, written)}
            self._demonstrations.append(demonstration_rows(new, files, time.time_ns()), marks)
        return answers

    def _write_actions(self, new: Sequence[Demonstration], followed: int, written: int) -> dict[str, int]:
        """Before the demonstrations' own rows: until those are there, nobody sees the actions, and a second try skips
        them. The mark by which the demonstrations' table tells that all actions are followed by it.

        `written` counts the appends of actions, `followed` up to which of them nothing is left over. Only where an
        append was not followed, since its writer ended or has not come so far, it is looked which actions there are.
        """
        there = self._actions.distinct(KEY) if written > followed else set()
        missing = [each for each in new if each.actions and _key(each) not in there]
        if missing:
            self._actions.append(action_rows(missing), {WRITTEN: written + 1})
        left_over = there - set(map(_key, new)) - set(self._digests().items() if there else ())
        written += bool(missing)
        return {WRITTEN: written} if written > followed and not left_over else {}

    def _try_to_quarantine(self, refused: Sequence[Quarantined]) -> int:
        if not refused:
            return 0
        decided = self._quarantine.mark(DECIDED)
        newest = {each.file: each for each in self._quarantine_records({each.file for each in refused})}
        new = {each.file: each for each in refused if not each.says(newest.get(each.file))}
        if new:
            rows = pa.Table.from_pylist([vars(each) for each in new.values()], QUARANTINE)
            self._quarantine.append(rows, {DECIDED: decided + 1})
        return len(new)

    def _try_to_correct(self, kind: Literal["exclude", "restore"], demonstration_id: str) -> bool:
        serial = self._next_serial()
        if self.entry(demonstration_id).excluded == (kind == "exclude"):
            return False
        self._correct(serial, kind, demonstration_id)
        return True

    def _try_to_relabel(self, demonstration_id: str, step: int, type_: ActionType) -> bool:
        serial = self._next_serial()
        actions = {action.step: action for action in self.entry(demonstration_id).demonstration.actions}
        if step not in actions:
            raise NotStoredError(f"step of {demonstration_id}", step, actions)
        if type_ not in get_args(ActionType):
            raise RelabelRefusedError(f"{type_!r} is no type of an action; there are {', '.join(get_args(ActionType))}")
        present = actions[step].type
        if present == type_:
            return False
        if present not in RELEASES or type_ not in RELEASES:
            raise RelabelRefusedError(
                f"step {step} of {demonstration_id} is a {present} by the gripper; only place and drop can be exchanged"
            )
        self._correct(serial, "relabel", demonstration_id, step, type_)
        return True

    def _try_to_undo(self, demonstration_id: str, steps: Sequence[int]) -> bool:
        serial = self._next_serial()
        entry = self.entry(demonstration_id)
        actions = {action.step: action for action in entry.demonstration.actions}
        for step in steps:
            if step not in actions and step not in entry.taken_back:
                raise NotStoredError(f"step of {demonstration_id}", step, actions)
        new = [step for step in dict.fromkeys(steps) if step in actions]
        _check_in_turn(demonstration_id, [action for step, action in actions.items() if step not in new])
        if new:
            self._correct_all(serial, demonstration_id, new)
        return bool(new)

    def _correct_all(self, serial: int, demonstration_id: str, steps: Sequence[int]) -> None:
        row = {"corrected_ns": time.time_ns(), "kind": "undo", "demonstration_id": demonstration_id, "type": None}
        rows = [row | {"serial": serial + number, "step": step} for number, step in enumerate(steps)]
        marks = {"corrections": serial + len(steps) - 1}
        self._corrections.append(pa.Table.from_pylist(rows, CORRECTIONS), marks)

    def _correct(
        self,
        serial: int,
        kind: CorrectionKind,
        demonstration_id: str,
        step: int | None = None,
        type_: ActionType | None = None,
    ) -> None:
        row = {"serial": serial, "corrected_ns": time.time_ns(), "kind": kind, "demonstration_id": demonstration_id}
        rows = pa.Table.from_pylist([row | {"step": step, "type": type_}], CORRECTIONS)
        self._corrections.append(rows, {"corrections": serial})

    def _next_serial(self) -> int:
        """Taken before a decision is made, so that a correction that was made meanwhile is noticed."""
        return 1 + max(self._corrections.read(["serial"])["serial"].to_pylist(), default=0)

    def _corrections_by_id(self) -> dict[str, list[Row]]:
        found: dict[str, list[Row]] = {}
        for row in sorted(self._corrections.read().to_pylist(), key=lambda row: int(row["serial"])):
            found.setdefault(row["demonstration_id"], []).append(row)
        return found

    def _quarantine_records(self, files: Collection[str] | None = None) -> list[Quarantined]:
        """The newest word on each file, or on each of `files`, oldest first."""
        filters = [] if files is None else [("file", "in", sorted(files))]
        records = [Quarantined(**row) for row in self._quarantine.read(filters=filters).to_pylist()]
        newest = {record.file: record for record in sorted(records, key=lambda record: record.quarantined_ns)}
        return sorted(newest.values(), key=lambda record: (record.quarantined_ns, record.file))

    def _digests(self) -> dict[str, str]:
        return _pairs(self._demonstrations.read(["demonstration_id", "sha256"]))


def _key(demonstration: Demonstration) -> tuple[str, str]:
    return demonstration.demonstration_id, demonstration.sha256


def _pairs(table: pa.Table) -> dict[str, str]:
    return dict(zip(table["demonstration_id"].to_pylist(), table["sha256"].to_pylist(), strict=True))


def _meant(corrections: Sequence[Row]) -> dict[str, Any]:
    """The newest words on a demonstration: whether it is `excluded`, and what its steps were `meant` to be."""
    kept = [row["kind"] for row in corrections if row["kind"] in ("exclude", "restore")]
    meant = {row["step"]: row["type"] or "undo" for row in corrections if row["kind"] in ("relabel", "undo")}
    return {"excluded": kept[-1:] == ["exclude"], "meant": meant}


def _corrected(demonstration: Demonstration, corrections: Sequence[Row]) -> Entry:
    if not corrections:
        return Entry(demonstration, excluded=False)
    excluded = False
    meant: dict[int, ActionType | None] = {}
    for row in corrections:
        if row["kind"] in ("relabel", "undo"):
            meant[row["step"]] = row["type"]
        else:
            excluded = row["kind"] == "exclude"
    types = {step: type_ for step, type_ in meant.items() if type_ is not None}
    left = [action for action in demonstration.actions if action.step not in meant or action.step in types]
    changed = {a.step: a.type for a in left if types.get(a.step, a.type) != a.type}
    actions = tuple(replace(a, type=types[a.step], relabelled=True) if a.step in types else a for a in left)
    taken_back = tuple(sorted(step for step in meant if step not in types))
    return Entry(replace(demonstration, actions=actions), excluded, changed, taken_back)


def _check_in_turn(demonstration_id: str, actions: Sequence[DemonstratedAction]) -> None:
    """Raises RelabelRefusedError for what cannot have happened: all taken back, or a pick or a release too many."""
    if not actions:
        raise RelabelRefusedError(
            f"nothing of {demonstration_id} would be left; `treewright demos exclude` leaves it out"
        )
    held: str | None = None
    for action in actions:
        picks = action.type == "pick"
        if picks == (held is not None) or (not picks and action.object != held):
            raise RelabelRefusedError(
                f"then step {action.step} of {demonstration_id} would be a {action.type} of {action.object} while "
                f"{held or 'nothing'} is held; take back a pick and its release together"
            )
        held = action.object if picks else None


def _start(demonstration: Demonstration) -> tuple[int, str]:
    stamps = [action.stamp_ns for action in demonstration.actions[:1]]
    start_ns = demonstration.start_ns if demonstration.start_ns is not None else min(stamps, default=0)
    return start_ns, demonstration.demonstration_id


def _until_won(attempt: Callable[[], Result]) -> Result:
    for count in range(ATTEMPTS):
        try:
            return attempt()
        except LostRaceError:
            time.sleep(0.005 * count)
    raise StorageUnavailableError(f"the lake is written by too many at once; {ATTEMPTS} attempts failed, try again")
