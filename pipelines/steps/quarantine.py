"""A demonstration in quarantine: shown press by press, corrected, and judged again; its recording is never changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from learner.model import Recording
from learner.observation.corrections import Correction, Meant, corrected
from learner.observation.presses import Judgement, Numbered, judge_all
from learner.observation.segmenting import done_in
from learner.observation.surroundings import surroundings_of
from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.steps.ingest import IngestResult, ingest
from recorder.errors import RecorderError
from recorder.recording import read_header, read_recording, sha256_of
from storage.errors import NotStoredError
from storage.lake import Lake, Quarantined


@dataclass(frozen=True)
class QuarantinedDemonstration:
    """A recording that was refused for `reason`: its `files`, what it holds, and what a person corrected in it."""

    files: tuple[Path, ...]
    reason: str
    recording: Recording
    corrections: tuple[Correction, ...]

    @property
    def presses(self) -> list[Numbered]:
        """Those that the recording leaves standing, else what was done by hand."""
        return done_in(self.recording)[0]

    @property
    def judgements(self) -> list[Judgement]:
        """The presses as they were meant, judged."""
        presses = corrected(self.presses, self.corrections)
        return list(judge_all(presses, surroundings_of(self.recording), self.recording.gripper))

    @property
    def taken_back(self) -> list[int]:
        """The numbers of the presses that a person took back."""
        left = {each.step for each in corrected(self.presses, self.corrections)}
        return [each.step for each in self.presses if each.step not in left]


def find_quarantined(home: Home, lake: Lake, demonstration_id: str) -> QuarantinedDemonstration | None:
    """The demonstration of this id in quarantine, None if there is none that can be read.

    Raises RecorderError if its recording is damaged: there is nothing to correct then.
    """
    records = [(record, file) for record in lake.quarantined() if (file := _file_of(home, record))]
    of_it = [(record, file) for record, file in records if _id_of(file) == demonstration_id]
    if not of_it:
        return None
    distinct = {record.sha256: file for record, file in of_it}
    files = tuple(sorted(distinct.values()))
    words = lake.corrections().get(demonstration_id, [])
    corrections = tuple(Correction(step, meant) for step, meant in words)
    return QuarantinedDemonstration(files, of_it[-1][0].reason, read_recording(files), corrections)


def id_of_quarantined(home: Home, record: Quarantined) -> str | None:
    """The id of the demonstration in a refused file; None where the file is gone or tells none."""
    file = _file_of(home, record)
    return None if file is None else _id_of(file)


def correct_quarantined(
    home: Home, lake: Lake, found: QuarantinedDemonstration, steps: Sequence[int], meant: Meant
) -> IngestResult:
    """Say what actions were meant to be, or take them back, and judge the demonstration again.

    Raises NotStoredError for a step that is none, CommandError for a signal that should be something else.
    """
    name, presses = found.recording.demonstration_id, {each.step: each.press for each in found.presses}
    for step in steps:
        if step not in presses:
            raise NotStoredError(f"step of {name}", step, presses)
        if meant != "undo" and presses[step].type == "signal":
            raise CommandError(f"step {step} of {name} sets a signal; it can be taken back, but is no {meant}")
    for step in steps:
        lake.correct_refused(name, step, meant)
    return ingest(home, lake, found.files)


def pressed_type(found: QuarantinedDemonstration, step: int) -> str:
    """What the operator had pressed."""
    return next(each.press.type for each in found.presses if each.step == step)


def _file_of(home: Home, record: Quarantined) -> Path | None:
    """Where the refused bytes are: in their own place, unless they have changed there, else in the copy."""
    places = (Path(record.file), home.quarantine / f"{record.sha256}.mcap")
    return next((place for place in places if record.sha256 and _holds(place, record.sha256)), None)


def _holds(place: Path, sha256: str) -> bool:
    return place.is_file() and sha256_of([place]) == sha256


def _id_of(file: Path) -> str | None:
    try:
        return read_header(file).demonstration_id
    except RecorderError:
        # What cannot be read has no id by which it could be asked for.
        return None
