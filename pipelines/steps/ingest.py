"""From recordings to the lake: what is new is read and observed; what breaks the contract is quarantined.

Recordings are read where they are and never changed. One that is refused is recorded with its reason; if it lies
outside the data root, a copy is kept in `quarantine/`, named by its digest. One bad file never stops the rest.

Files are judged in batches. A batch is one commit of each table, the demonstrations first and the memory of what was
judged last, so that one that dies is judged again, and what it had committed is then known by its digest.
"""

from __future__ import annotations

import secrets
import shutil
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from learner.errors import LearnerError
from learner.inference.labels import doubts
from learner.inference.parameters import InferenceParameters
from learner.model import Demonstration, Recording
from learner.observation import observe, warnings_of
from learner.observation.corrections import Correction
from learner.progress import tell
from pipelines.errors import CommandError
from pipelines.home import Home
from recorder.errors import RecorderError
from recorder.paths import is_file, is_folder, shown
from recorder.recording import Demonstrated, ReadFile, join_files, read_header, sha256_of
from storage.errors import ConflictError
from storage.judged import FileState, Judged
from storage.lake import Lake, Quarantined

RECORDING: Final = ".mcap"
LEAST_FREE_BYTES: Final = 8 << 20
BATCH: Final = 128
"""So many recordings are judged between two commits; of each only what is learned from stays in memory."""


@dataclass(frozen=True)
class Ingested:
    """A demonstration that is new in the lake: `warnings` of what was odd in it, `doubts` where a label does not fit
    what was seen.
    """

    demonstration_id: str
    task: str
    cell: str
    user: str
    outcome: str
    actions: int
    warnings: tuple[str, ...]
    doubts: tuple[str, ...]

    @classmethod
    def of(cls, demonstration: Demonstration) -> Self:
        """What is told of a demonstration."""
        d = demonstration
        warnings = (*warnings_of(d), *d.gaps)
        doubted = tuple(doubts(d, InferenceParameters()))
        return cls(d.demonstration_id, d.task, d.cell, d.user, d.outcome, len(d.actions), warnings, doubted)


@dataclass(frozen=True)
class Refused:
    """A recording that went to quarantine, and why; or, if `missing`, a file that was named and is not there."""

    file: str
    reason: str
    missing: bool = False

    def __str__(self) -> str:
        return f"{'' if self.missing else 'quarantined '}{self.file}: {self.reason}"


@dataclass(frozen=True)
class Source:
    """The files of one recording: a single one, or all parts of a split one in their order."""

    files: tuple[Path, ...]


@dataclass(frozen=True)
class Waiting:
    """A split demonstration that does not count yet: not all of its parts are there."""

    demonstration_id: str
    parts: tuple[int, ...]


@dataclass(frozen=True)
class IngestResult:
    """What became of the recordings of one ingest."""

    ingested: tuple[Ingested, ...]
    known: tuple[str, ...]
    quarantined: tuple[Refused, ...]
    waiting: tuple[Waiting, ...]

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks of which there is something new to learn."""
        return tuple(sorted({each.task for each in self.ingested}))

    @property
    def sentence(self) -> str:
        """How many of each."""
        waiting = f", {len(self.waiting)} waiting for a part" if self.waiting else ""
        return f"{len(self.ingested)} ingested, {len(self.known)} known, {len(self.quarantined)} quarantined{waiting}"

    def to_data(self) -> dict[str, Any]:
        """The JSON document of CONTRACT, section 4.

        `waiting` only where a split demonstration lacks a part, `doubts` only where a label does not seem to fit.
        """
        document: dict[str, Any] = {
            "ingested": [each.demonstration_id for each in self.ingested],
            "known": list(self.known),
            "quarantined": [{"file": each.file, "reason": each.reason} for each in self.quarantined],
        }
        waiting = [{"demonstration_id": each.demonstration_id, "parts": list(each.parts)} for each in self.waiting]
        doubted = {each.demonstration_id: list(each.doubts) for each in self.ingested if each.doubts}
        return document | ({"waiting": waiting} if waiting else {}) | ({"doubts": doubted} if doubted else {})


def ingest(home: Home, lake: Lake, named: Sequence[Path] = ()) -> IngestResult:
    """Ingest the named recordings (of a folder: all below it), or whatever is new below `home.recordings`.

    What is known already changes nothing; what was refused before is judged again only if it is named or has changed.
    Raises CommandError where there is no room, StorageUnavailableError if the lake cannot be used.
    """
    files = _expanded(named) if named else _recordings_below(home.recordings)
    return _Ingest(home, lake, bool(named), files).run()


def unsettled(home: Home, lake: Lake) -> dict[Path, FileState | None]:
    """The recordings below the data root that an ingest would read, as they are now."""
    pass_ = _Ingest(home, lake, False, _recordings_below(home.recordings))
    return {file: _state(file) for file in pass_.unsettled()}


class _Ingest:
    """One pass: every file ends in exactly one of the lists."""

    def __init__(self, home: Home, lake: Lake, again: bool, files: Sequence[Path]) -> None:
        self.home, self.lake, self.again, self.files = home, lake, again, files
        self.corrections = lake.corrections()
        self.ingested: list[Ingested] = []
        self.known: list[str] = []
        self.quarantined: list[Refused] = []
        self.waiting: list[Waiting] = []

    def run(self) -> IngestResult:
        """Judge every file: single ones first, then parts with those of their demonstration."""
        _check_room(self.home)
        new, parts = self.unsettled(), {}
        for begin in range(0, len(new), BATCH):
            with _Batch(self) as batch:
                parts.update(batch.take([Source((file,)) for file in new[begin : begin + BATCH]]))
        joined = list(self._joined(parts))
        for begin in range(0, len(joined), BATCH):
            with _Batch(self) as batch:
                batch.take(joined[begin : begin + BATCH])
        known = sorted({*self.known} - {each.demonstration_id for each in self.ingested})
        return IngestResult(tuple(self.ingested), tuple(known), tuple(self.quarantined), tuple(self.waiting))

    def unsettled(self) -> list[Path]:
        """The files that have to be read; the others are as they were when they were judged."""
        judged = self.lake.files.of({shown(file) for file in self.files})
        stored = self.lake.stored(ids={each.demonstration_id for each in judged.values() if each.demonstration_id})
        new = []
        for file in self.files:
            before = judged.get(shown(file))
            if before is None or not self._is_settled(file, before, stored):
                new.append(file)
            elif before.demonstration_id:
                self.known.append(before.demonstration_id)
        return new

    def _is_settled(self, file: Path, before: Judged, stored: Mapping[str, str]) -> bool:
        if _state(file) != before.state:
            return False
        return not self.again if before.demonstration_id is None else before.demonstration_id in stored

    def _joined(self, headers: dict[Path, Demonstrated]) -> Iterator[Source]:
        """The parts with those of their demonstration in the same folder, else in any."""
        groups: dict[tuple[Path, str], dict[Path, Demonstrated]] = defaultdict(dict)
        for file, header in headers.items():
            groups[file.parent, header.demonstration_id][file] = header
        lone: dict[str, dict[Path, Demonstrated]] = defaultdict(dict)
        for (folder, demonstration_id), parts in groups.items():
            beside = parts | self._parts_beside(folder, demonstration_id)
            if isinstance(source := _join(beside), Source):
                yield source
            else:
                lone[demonstration_id] |= beside
        for source in map(_join, lone.values()):
            if isinstance(source, Source):
                yield source
            else:
                self.waiting.append(source)

    def _parts_beside(self, folder: Path, demonstration_id: str) -> dict[Path, Demonstrated]:
        """The parts of a demonstration that lie in a folder; files known as another's are not opened."""
        files = _recordings_below(folder)
        judged = self.lake.files.of({shown(file) for file in files})
        found: dict[Path, Demonstrated] = {}
        for file in files:
            before = judged.get(shown(file))
            if before and before.demonstration_id not in (None, demonstration_id):
                continue
            header = _part_header(file)
            if header and header.demonstration_id == demonstration_id:
                found[file] = header
        return found


class _Batch:
    """Recordings that are judged together; leaving the block without an exception writes what came of them."""

    def __init__(self, ingest: _Ingest) -> None:
        self.ingest, self.lake = ingest, ingest.lake
        self.taken: dict[str, tuple[Demonstration, Source]] = {}
        self.refused: list[Quarantined] = []
        self.judged: list[Judged] = []
        self.states: dict[Path, FileState | None] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._write()

    def take(self, sources: Sequence[Source]) -> dict[Path, Demonstrated]:
        """Judge every source, but for single files that turn out to be parts: the headers of those are returned."""
        digests = {source: sha256 for source in sources if (sha256 := self._digest(source)) is not None}
        known = {sha256: name for name, sha256 in self.lake.stored(digests=set(digests.values())).items()}
        parts: dict[Path, Demonstrated] = {}
        for number, (source, sha256) in enumerate(digests.items(), start=1):
            tell(f"reading {shown(source.files[0].name)}, {number} of {len(digests)}")
            if sha256 in known:
                self._note_known(source, sha256, known[sha256])
            elif header := self._take_new(source, sha256):
                parts[source.files[0]] = header
        return parts

    def _digest(self, source: Source) -> str | None:
        """The digest of the bytes; what cannot be read is refused."""
        tell(f"looking at {shown(source.files[0].name)}")
        # The state before the bytes: what changes while they are read is judged again.
        self.states.update({file: _state(file) for file in source.files})
        try:
            return sha256_of(source.files)
        except (RecorderError, OSError) as error:
            self._refuse(source, None, error)
            return None

    def _take_new(self, source: Source, sha256: str) -> Demonstrated | None:
        try:
            read = [ReadFile(file) for file in source.files]
            if len(read) == 1 and read[0].demonstrated.part is not None:
                return read[0].demonstrated
            self._take_demonstration(self._observed(join_files(read, sha256)), source)
        except (LearnerError, RecorderError, ConflictError, OSError) as error:
            self._refuse(source, sha256, error)
        except Exception as error:  # noqa: BLE001  # one bad file never stops the rest, whatever it is
            self._refuse(source, sha256, _defect(error))
        return None

    def _observed(self, recording: Recording) -> Demonstration:
        """By what a person corrected in it since, if it was in quarantine."""
        words = self.ingest.corrections.get(recording.demonstration_id, [])
        return observe(recording, corrections=[Correction(step, type_) for step, type_ in words])

    def _take_demonstration(self, demonstration: Demonstration, source: Source) -> None:
        """Raises ConflictError if its id is taken by other content in this batch."""
        name = demonstration.demonstration_id
        if name not in self.taken:
            self.taken[name] = demonstration, source
        elif self.taken[name][0].sha256 == demonstration.sha256:
            self._note_known(source, demonstration.sha256, name)
        else:
            raise ConflictError(name, demonstration.sha256, self.taken[name][0].sha256)

    def _write(self) -> None:
        _check_room(self.ingest.home)
        self._refuse_conflicting()
        tell(f"writing {len(self.taken)} demonstrations to the lake")
        try:
            self._add(list(self.taken.values()))
        except ConflictError:
            # Somebody else took an id meanwhile: find out whose.
            for pair in self.taken.values():
                self._add_or_refuse(*pair)
        self.lake.quarantine_all(self.refused)
        self.lake.files.note(self.judged)

    def _refuse_conflicting(self) -> None:
        stored = self.lake.stored(ids=set(self.taken))
        for name in stored.keys() & self.taken.keys():
            demonstration, source = self.taken[name]
            if stored[name] != demonstration.sha256:
                del self.taken[name]
                self._refuse(source, demonstration.sha256, ConflictError(name, demonstration.sha256, stored[name]))

    def _add(self, taken: Sequence[tuple[Demonstration, Source]]) -> None:
        """Write what is new. Raises ConflictError."""
        files = {demonstration.demonstration_id: list(map(shown, source.files)) for demonstration, source in taken}
        demonstrations = [demonstration for demonstration, _ in taken]
        answers = self.lake.add_all(demonstrations, files) if demonstrations else []
        for (demonstration, source), new in zip(taken, answers, strict=True):
            self._note(source, demonstration.sha256, demonstration.demonstration_id)
            if new:
                self.ingest.ingested.append(Ingested.of(demonstration))
            else:
                self.ingest.known.append(demonstration.demonstration_id)

    def _add_or_refuse(self, demonstration: Demonstration, source: Source) -> None:
        try:
            self._add([(demonstration, source)])
        except ConflictError as error:
            self._refuse(source, demonstration.sha256, error)

    def _note_known(self, source: Source, sha256: str, demonstration_id: str) -> None:
        self.ingest.known.append(demonstration_id)
        self._note(source, sha256, demonstration_id)

    def _note(self, source: Source, sha256: str | None, demonstration_id: str | None) -> None:
        """Remember what became of files; those that are not there, or are none, have no state to know them by."""
        states = {file: state for file in source.files if (state := self.states[file]) is not None}
        self.judged += [Judged(shown(file), state, sha256, demonstration_id) for file, state in states.items()]

    def _refuse(self, source: Source, sha256: str | None, error: BaseException) -> None:
        reason = _sentence(error)
        for file in source.files:
            self.ingest.quarantined.append(Refused(shown(file), reason, isinstance(error, FileNotFoundError)))
            if is_file(file):
                self.refused.append(Quarantined(shown(file), _keep(self.ingest.home, file), reason))
        self._note(source, sha256, None)


def _state(file: Path) -> FileState | None:
    """The state of a file; None where there is none, or no name that the system admits."""
    try:
        return FileState.of(file) if is_file(file) else None
    except OSError:
        return None


def _check_room(home: Home) -> None:
    """Before anything is written: a lake that runs out of room in the middle tells it less clearly."""
    there = next(folder for folder in (home.root, *home.root.parents) if folder.exists())
    free_bytes = shutil.disk_usage(there).free
    if free_bytes < LEAST_FREE_BYTES:
        raise CommandError(f"{home.root} has only {free_bytes // 1024} KiB left; free some room, then ingest again")


def _recordings_below(folder: Path) -> list[Path]:
    return sorted(file for file in folder.rglob(f"*{RECORDING}") if file.is_file())


def _expanded(named: Iterable[Path]) -> list[Path]:
    """Absolute paths, each once, a folder replaced by the recordings below it."""
    files = (
        file
        for path in named
        for file in (_recordings_below(path.absolute()) if is_folder(path) else [path.absolute()])
    )
    return list(dict.fromkeys(files))


def _part_header(file: Path) -> Demonstrated | None:
    """The header of a part of a split demonstration; None for any other file."""
    try:
        header = read_header(file)
    except (RecorderError, OSError):
        # It is judged where it is itself looked at, not where its neighbour is.
        return None
    return header if header.part is not None else None


def _join(parts: dict[Path, Demonstrated]) -> Source | Waiting:
    """The parts as one source if all are there: from 1 on without a gap, at least two, the last one not continued."""
    files = sorted(parts, key=lambda file: (parts[file].part or 0, file))
    numbers = tuple(parts[file].part or 0 for file in files)
    distinct = sorted(set(numbers))
    if len(distinct) > 1 and distinct == list(range(1, len(distinct) + 1)) and not parts[files[-1]].continued:
        return Source(tuple(files))
    return Waiting(parts[files[0]].demonstration_id, numbers)


def _keep(home: Home, file: Path) -> str | None:
    """The digest of a refused file, None if it cannot be read; a copy is kept if it lies outside the data root."""
    try:
        sha256 = sha256_of([file])
    except OSError:
        # Unreadable is why it was refused; the reason says so already.
        return None
    place = home.quarantine / f"{sha256}{RECORDING}"
    if not file.is_relative_to(home.root) and not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        beside = place.with_name(f"{place.name}.{secrets.token_hex(4)}.part")
        try:
            shutil.copyfile(file, beside)
            beside.replace(place)
        finally:
            beside.unlink(missing_ok=True)
    return sha256


def _defect(error: Exception) -> Exception:
    return RuntimeError(f"a defect in treewright met it: {type(error).__name__}: {error}")


def _sentence(error: BaseException) -> str:
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    if isinstance(error, OSError):
        return f"{shown(error.filename) if error.filename else 'it'} cannot be read: {error.strerror or error}"
    return " ".join(str(error).split())
