"""The reader of recordings: what a file says of itself, its messages, the digest of its bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata

from recorder.errors import NotARecordingError
from recorder.recording import records
from recorder.recording.demonstrated import DEMONSTRATION, Demonstrated


def read_header(file: Path) -> Demonstrated:
    """What a file's last metadata record says; the messages are not decoded.

    Raises NotARecordingError and TornRecordingError as `read_recording` does, OSError if the file cannot be read.
    """
    last: Metadata | None = None
    for record in records.walk(file):
        if record.opcode == Opcode.METADATA:
            parsed = cast(Metadata, records.parse(record))
            last = parsed if parsed.name == DEMONSTRATION else last
    if last is None:
        raise NotARecordingError(file, f"it has no metadata record {DEMONSTRATION}")
    return Demonstrated.from_metadata(file, last.metadata)


def messages(file: Path, topics: frozenset[str] | None = None) -> Iterator[tuple[Channel, Message]]:
    """The messages of a file in the order in which they were recorded, of these topics or of all.

    Every chunk's checksum is verified. Raises as `read_recording`.
    """
    channels: dict[int, Channel] = {}
    for record in records.walk(file):
        if record.opcode == Opcode.DATA_END:
            continue
        for found in _contents(record):
            if isinstance(found, Channel):
                channels[found.id] = found
            elif isinstance(found, Message):
                channel = channels.get(found.channel_id)
                if channel is None:
                    raise NotARecordingError(
                        file, f"it is damaged: a message on channel {found.channel_id}, never told"
                    )
                if topics is None or channel.topic in topics:
                    yield channel, found


def _contents(record: records.Record) -> Iterable[Any]:
    if record.opcode == Opcode.CHUNK:
        return records.unpack(record)
    if record.opcode == Opcode.MESSAGE:
        return [records.message(record)]
    if record.opcode == Opcode.ATTACHMENT:
        records.check_attachment(record)
        return []
    return [found] if (found := records.parse(record)) is not None else []


def sha256_of(files: Sequence[Path]) -> str:
    """The digest of the files' bytes, in this order. Raises NotARecordingError for a pipe or a device."""
    digest = hashlib.sha256()
    for file in files:
        records.check_regular(file)
        with file.open("rb") as stream:
            for block in iter(lambda: stream.read(1 << 20), b""):
                digest.update(block)
    return digest.hexdigest()
