"""Completing torn recordings from their whole chunks.

The torn file is only read. A copy takes over every whole record, gets the end that is missing, is read back and
verified, and says in its metadata that it was recovered. What is not a plain torn end is nobody's to guess about.
"""

from __future__ import annotations

import fcntl
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema

from recorder import records
from recorder.chunks import Batch
from recorder.errors import NotARecordingError, RecorderError, SecondRecorderError, TornRecordingError
from recorder.recording import DEMONSTRATION, UNFINISHED, Demonstrated, Finished, RecordingWriter, sync_folder

TORN, QUARANTINE = "torn", "quarantine"
"""Folders beside the recordings: originals that were completed, and files that are damaged otherwise."""
RECOVERING: Final = ".recovering"
"""Ends the name of a copy that is being completed."""
LOCK: Final = ".recorder.lock"


@dataclass(frozen=True)
class Recovered:
    """A torn file and what became of it; `cut_bytes` at its end belonged to no whole record."""

    torn: Path
    finished: Finished
    cut_bytes: int


def recover(torn: Path, file: Path) -> Recovered:
    """Complete `torn` as `file`; `torn` is left as it is.

    Raises NotARecordingError for damage that is no torn end and for a file without the metadata record, RecorderError
    if the file is whole or `file` exists, OSError as the file system does.
    """
    demonstrated = _last_demonstrated(torn)
    if file.exists():
        raise RecorderError(f"{file} exists already; a recording is never overwritten")
    copy = file.with_name(file.name + RECOVERING)
    unfinished = copy.with_name(copy.name + UNFINISHED)
    for left in (copy, unfinished):
        left.unlink(missing_ok=True)  # of a recovery that was itself cut off
    with ExitStack() as undo:
        undo.callback(unfinished.unlink, missing_ok=True)
        writer = undo.enter_context(RecordingWriter(copy, demonstrated))
        end = _copy(torn, writer)
        lost = dict.fromkeys(writer.messages)
        more = {**demonstrated.more, "recovered": "true"}
        finished = writer.finish(replace(demonstrated, messages_lost=lost, more=more))
    copy.rename(file)
    sync_folder(file.parent)
    return Recovered(torn, replace(finished, file=file), torn.stat().st_size - end)


def _last_demonstrated(torn: Path) -> Demonstrated:
    """What a torn file says of itself, every record of it checked."""
    last: Metadata | None = None
    try:
        for record in records.walk(torn):
            parsed = records.parse(torn, record)
            if isinstance(parsed, Metadata) and parsed.name == DEMONSTRATION:
                last = parsed
    except TornRecordingError:
        if last is None:
            raise NotARecordingError(torn, f"it is torn before its metadata record {DEMONSTRATION}") from None
        return Demonstrated.from_metadata(torn, last.metadata)
    raise RecorderError(f"{torn} is whole; there is nothing to recover")


def _copy(torn: Path, writer: RecordingWriter) -> int:
    """Take over what is whole; returns where that ends [bytes]."""
    end, schemas = 0, dict[int, Schema]()
    try:
        for record in records.walk(torn):
            if record.opcode == Opcode.DATA_END:
                # What follows is the summary, which is written anew.
                break
            try:
                _take_over(torn, record, writer, schemas)
            except NotARecordingError:
                if _ends_in_zeros(torn, record):
                    return end
                raise
            end = record.end
    except TornRecordingError:
        # The reason why we are here.
        return end
    return end


def _ends_in_zeros(torn: Path, record: records.Record) -> bool:
    """Whether a record, and all after it, ends in zeros that its system never replaced, as after a power cut."""
    with torn.open("rb") as stream:
        stream.seek(record.end - 1)
        return not any(block.strip(b"\0") for block in iter(lambda: stream.read(1 << 20), b""))


def _take_over(torn: Path, record: records.Record, writer: RecordingWriter, schemas: dict[int, Schema]) -> None:
    if record.opcode == Opcode.CHUNK:
        contents = records.unpack(torn, record)
    elif record.opcode == Opcode.MESSAGE:
        contents = [records.message(torn, record)]
    else:
        parsed = records.parse(torn, record)
        contents = [] if parsed is None else [parsed]
    batch = Batch()
    for found in contents:
        if isinstance(found, Schema):
            schemas[found.id] = found
        elif isinstance(found, Channel):
            writer.adopt(found, schemas.get(found.schema_id))
        elif isinstance(found, Message):
            batch.add(found.channel_id, found.sequence, found.log_time, found.publish_time, found.data)
        elif isinstance(found, Metadata) and found.name != DEMONSTRATION:
            writer.adopt_metadata(found)
    if len(batch):
        writer.write_batch(batch)


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
    return "recovered", f"{file} was torn and is completed with {total} messages; the torn original is {kept}"


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
