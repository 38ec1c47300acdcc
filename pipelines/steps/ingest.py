"""From recordings to the lake: what is new is read and observed; what breaks the contract is quarantined.

Recordings are read where they are and never changed. One that is refused is recorded with its reason; if it lies
outside the data root, a copy is kept in `quarantine/`, named by its digest. One bad file never stops the rest.
"""

from __future__ import annotations

import secrets
import shutil
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from learner.errors import LearnerError
from learner.inference.labels import doubts
from learner.inference.parameters import InferenceParameters
from learner.model import Demonstration, Recording
from learner.observation import observe
from learner.observation.corrections import Correction
from learner.progress import tell
from pipelines.errors import CommandError
from pipelines.home import Home
from recorder.errors import RecorderError
from recorder.paths import is_file, is_folder, shown
from recorder.recording import Demonstrated, read_header, read_recording, sha256_of
from storage.errors import ConflictError
from storage.lake import Lake

RECORDING: Final = ".mcap"
LEAST_FREE_BYTES: Final = 8 << 20


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

    ingested: tuple[Demonstration, ...]
    known: tuple[str, ...]
    quarantined: tuple[Refused, ...]
    waiting: tuple[Waiting, ...]

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks of which there is something new to learn."""
        return tuple(sorted({demonstration.task for demonstration in self.ingested}))

    def to_data(self) -> dict[str, Any]:
        """The JSON document of CONTRACT, section 4.

        `waiting` only where a split demonstration lacks a part, `doubts` only where a label does not seem to fit.
        """
        document: dict[str, Any] = {
            "ingested": [demonstration.demonstration_id for demonstration in self.ingested],
            "known": list(self.known),
            "quarantined": [{"file": each.file, "reason": each.reason} for each in self.quarantined],
        }
        waiting = [{"demonstration_id": each.demonstration_id, "parts": list(each.parts)} for each in self.waiting]
        doubts = {each.demonstration_id: sentences for each in self.ingested if (sentences := doubts_about(each))}
        return document | ({"waiting": waiting} if waiting else {}) | ({"doubts": doubts} if doubts else {})


def doubts_about(demonstration: Demonstration) -> list[str]:
    """Where an operator's label does not fit what was seen, with the evidence."""
    return list(doubts(demonstration, InferenceParameters()))


def ingest(home: Home, lake: Lake, named: Sequence[Path] = ()) -> IngestResult:
    """Ingest the named recordings (of a folder: all below it), or whatever is new below `home.recordings`.

    What is known already changes nothing; what was refused before is judged again only if it is named or has changed.
    Raises CommandError where there is no room, StorageUnavailableError if the lake cannot be used.
    """
    _check_room(home)
    work = _Ingest(home, lake, again=bool(named))
    work.take(_expanded(named) if named else _recordings_below(home.recordings))
    return work.finish()


class _Ingest:
    """One pass: every file ends in exactly one of the lists."""

    def __init__(self, home: Home, lake: Lake, again: bool) -> None:
        self.home, self.lake, self.again = home, lake, again
        self.known_ids, self.known_files, self.since_ns = lake.known(), lake.known_files(), lake.known_since_ns()
        self.corrections = lake.corrections()
        self.taken: dict[str, tuple[Demonstration, Source]] = {}
        self.known: list[str] = []
        self.quarantined: list[Refused] = []
        self.waiting: list[Waiting] = []

    def take(self, files: Iterable[Path]) -> None:
        """Judge every file."""
        headers: dict[Path, Demonstrated] = {}
        for file in files:
            tell(f"looking at {shown(file.name)}")
            if self._is_settled(file):
                self._note_known(self.known_files[shown(file)])
            elif header := self._header(file):
                headers[file] = header
        for number, source in enumerate(self._sources(headers), start=1):
            tell(f"reading {shown(source.files[0].name)}, {number} of at most {len(headers)}")
            self._take_source(source)

    def finish(self) -> IngestResult:
        """Write what was taken in one commit."""
        tell(f"writing {len(self.taken)} demonstrations to the lake")
        try:
            new = self._add(list(self.taken.values()))
        except ConflictError:
            # Somebody else took an id meanwhile: find out whose.
            new = [each for pair in self.taken.values() for each in self._add_or_refuse(*pair)]
        known = sorted({*self.known} - {demonstration.demonstration_id for demonstration in new})
        return IngestResult(tuple(new), tuple(known), tuple(self.quarantined), tuple(self.waiting))

    def _is_settled(self, file: Path) -> bool:
        """Whether the file was judged before and has not changed since (by the time of its last change)."""
        since_ns = self.since_ns.get(shown(file))
        if since_ns is None or not is_file(file) or file.stat().st_ctime_ns > since_ns:
            return False
        return not self.again or self.known_files[shown(file)] in self.known_ids

    def _note_known(self, sha256: str | None) -> None:
        if sha256 in self.known_ids:
            self.known.append(self.known_ids[sha256])

    def _header(self, file: Path) -> Demonstrated | None:
        try:
            return read_header(file)
        except (RecorderError, OSError) as error:
            self._refuse((file,), error)
        except Exception as error:  # noqa: BLE001  # one bad file never stops the rest, whatever it is
            self._refuse((file,), _defect(error))
        return None

    def _sources(self, headers: dict[Path, Demonstrated]) -> Iterator[Source]:
        """Single files as they are; parts with those of their demonstration in the same folder, else in any."""
        groups: dict[tuple[Path, str], dict[Path, Demonstrated]] = defaultdict(dict)
        for file, header in headers.items():
            if header.part is None:
                yield Source((file,))
            else:
                groups[file.parent, header.demonstration_id][file] = header
        lone: dict[str, dict[Path, Demonstrated]] = defaultdict(dict)
        for (folder, demonstration_id), parts in groups.items():
            beside = parts | self._parts_beside(folder, demonstration_id)
            if isinstance(source := _joined(beside), Source):
                yield source
            else:
                lone[demonstration_id] |= beside
        for source in map(_joined, lone.values()):
            if isinstance(source, Source):
                yield source
            else:
                self.waiting.append(source)

    def _parts_beside(self, folder: Path, demonstration_id: str) -> dict[Path, Demonstrated]:
        """The parts of a demonstration that lie in a folder; files known as another's are not opened."""
        found: dict[Path, Demonstrated] = {}
        for file in _recordings_below(folder):
            if self.known_ids.get(self.known_files.get(shown(file)) or "", demonstration_id) != demonstration_id:
                continue
            header = _part_header(file)
            if header and header.demonstration_id == demonstration_id:
                found[file] = header
        return found

    def _take_source(self, source: Source) -> None:
        try:
            sha256 = sha256_of(source.files)
            if sha256 in self.known_ids:
                self._note_known(sha256)
                return
            self._take_demonstration(self._observed(read_recording(source.files)), source)
        except (LearnerError, RecorderError, ConflictError, OSError) as error:
            self._refuse(source.files, error)
        except Exception as error:  # noqa: BLE001  # one bad file never stops the rest, whatever it is
            self._refuse(source.files, _defect(error))

    def _observed(self, recording: Recording) -> Demonstration:
        """By what a person corrected in it since, if it was in quarantine."""
        words = self.corrections.get(recording.demonstration_id, [])
        return observe(recording, corrections=[Correction(step, type_) for step, type_ in words])

    def _take_demonstration(self, demonstration: Demonstration, source: Source) -> None:
        """Raises ConflictError if its id is taken by other content, in the lake or in this pass."""
        name = demonstration.demonstration_id
        stored = {known: sha256 for sha256, known in self.known_ids.items()}.get(name)
        other = self.taken[name][0].sha256 if name in self.taken else stored
        if other == demonstration.sha256:
            self.known.append(name)
        elif other is not None:
            raise ConflictError(name, demonstration.sha256, other)
        else:
            self.taken[name] = demonstration, source

    def _add(self, taken: Sequence[tuple[Demonstration, Source]]) -> list[Demonstration]:
        """Those of `taken` that are new in the lake. Raises ConflictError."""
        files = {demonstration.demonstration_id: list(map(shown, source.files)) for demonstration, source in taken}
        demonstrations = [demonstration for demonstration, _ in taken]
        answers = self.lake.add_all(demonstrations, files) if demonstrations else []
        self.known += [d.demonstration_id for d, new in zip(demonstrations, answers, strict=True) if not new]
        return [demonstration for demonstration, new in zip(demonstrations, answers, strict=True) if new]

    def _add_or_refuse(self, demonstration: Demonstration, source: Source) -> list[Demonstration]:
        try:
            return self._add([(demonstration, source)])
        except ConflictError as error:
            self._refuse(source.files, error)
            return []

    def _refuse(self, files: Sequence[Path], error: BaseException) -> None:
        reason = _sentence(error)
        for file in files:
            self.quarantined.append(Refused(shown(file), reason, isinstance(error, FileNotFoundError)))
            if is_file(file):
                self.lake.quarantine(shown(file), _keep(self.home, file), reason)


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


def _joined(parts: dict[Path, Demonstrated]) -> Source | Waiting:
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
