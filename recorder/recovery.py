"""Completing torn and damaged recordings from what is whole in them.

The file is only read. A copy takes over every whole record, gets the end that is missing, is read back and verified,
and says in its metadata that it was recovered, and what is gone.
"""

from __future__ import annotations

import fcntl
import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from mcap.opcode import Opcode

from recorder.durable import sync_folder
from recorder.errors import NotARecordingError, RecorderError, SecondRecorderError, TornRecordingError
from recorder.paths import shown
from recorder.recording import UNFINISHED, Finished, RecordingWriter, messages, records
from recorder.salvage import Salvage

TORN, QUARANTINE = "torn", "quarantine"
"""Folders beside the recordings: originals that were completed, and files that are damaged otherwise."""
RECOVERING: Final = ".recovering"
"""Ends the name of a copy that is being completed."""
LOCK: Final = ".recorder.lock"


@dataclass(frozen=True)
class Recovered:
    """A torn or damaged file, what became of it, and what is `gone`: sentences, none where only an end is missing."""

    torn: Path
    finished: Finished
    cut_bytes: int
    """Bytes at its end that belonged to no whole record."""
    gone: tuple[str, ...] = ()


def recover(torn: Path, file: Path) -> Recovered:
    """Write all that is whole in `torn` as `file`; `torn` is left as it is.

    What lies before and behind a damaged chunk is kept, with the channels, attachments, metadata, profile and library;
    messages that stood outside of chunks are put into some. The copy is read again before it gets its name.

    Raises NotARecordingError for a file without the metadata record, RecorderError if the file is whole or `file`
    exists, OSError as the file system does.
    """
    salvage = Salvage(torn)
    demonstrated = salvage.demonstrated()
    if file.exists():
        raise RecorderError(f"{shown(file)} exists already; a recording is never overwritten")
    copy = file.with_name(file.name + RECOVERING)
    unfinished = copy.with_name(copy.name + UNFINISHED)
    for left in (copy, unfinished):
        left.unlink(missing_ok=True)  # of a recovery that was itself cut off
    with ExitStack() as undo:
        undo.callback(unfinished.unlink, missing_ok=True)
        writer = undo.enter_context(RecordingWriter(copy, demonstrated, salvage.header))
        salvage.copy(writer)
        lost = dict.fromkeys(writer.messages)
        more = {**demonstrated.more, "recovered": "true"}
        if salvage.gone:
            more["gone"] = json.dumps(salvage.gone)
        finished = writer.finish(replace(demonstrated, messages_lost=lost, more=more))
    _check(copy, finished)
    copy.rename(file)
    sync_folder(file.parent)
    return Recovered(torn, replace(finished, file=file), salvage.cut_bytes, tuple(salvage.gone))


def _check(copy: Path, finished: Finished) -> None:
    """Read the copy as anybody would. Raises RecorderError where it holds other messages than were written."""
    found = Counter(channel.topic for channel, _ in messages(copy))
    if dict(sorted(found.items())) != dict(finished.messages):
        raise RecorderError(f"{shown(copy)} does not hold what was recovered; check the disk")


@contextmanager
def sole_recorder(folder: Path, cell: str) -> Iterator[None]:
    """While inside, nobody else records into or recovers in `folder`. Raises SecondRecorderError."""
    with (folder / LOCK).open("wb") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise SecondRecorderError(cell) from error
        yield


def recover_folder(folder: Path, tell: Callable[[str, str], None]) -> Counter[str]:
    """Complete what a recorder left unfinished in `folder`, which nobody else records into; never raises for a file.

    `tell` gets each file's fate ('recovered', 'renamed', 'quarantined', 'failed') and a sentence.
    """
    fates: Counter[str] = Counter()
    for unfinished in sorted(folder.glob(f"*.mcap{UNFINISHED}")):
        fate, sentence = _recover_one(unfinished)
        fates[fate] += 1
        tell(fate, sentence)
    return fates


def _recover_one(unfinished: Path) -> tuple[str, str]:
    file = unfinished.with_name(unfinished.name.removesuffix(UNFINISHED))
    try:
        if file.exists():
            kept = _move(unfinished, TORN)
            return "recovered", f"{file} was recovered before; the torn original is {kept}"
        if _is_whole(unfinished):
            unfinished.rename(file)
            sync_folder(file.parent)
            return "renamed", f"{file} was whole and only lacked its name"
        recovered = recover(unfinished, file)
        kept = _move(unfinished, TORN)
    except NotARecordingError as error:
        kept = _move(unfinished, QUARANTINE)
        return "quarantined", f"{error}; it is kept untouched as {kept}"
    except (OSError, RecorderError) as error:
        return "failed", f"{unfinished} could not be recovered and stays as it is: {error}"
    total = sum(recovered.finished.messages.values())
    gone = "".join(f"; {sentence}" for sentence in recovered.gone)
    return "recovered", f"{file} was torn and is completed with {total} messages; the torn original is {kept}{gone}"


def _is_whole(file: Path) -> bool:
    """Whether a file has its end; all before that was written, synced and verified in this order."""
    try:
        for record in records.walk(file):
            if record.opcode == Opcode.FOOTER:
                return True
    except TornRecordingError:
        return False
    return False


def _move(file: Path, folder: str) -> Path:
    kept = file.parent / folder / file.name
    kept.parent.mkdir(exist_ok=True)
    file.rename(kept)
    sync_folder(kept.parent)
    sync_folder(file.parent)
    return kept
