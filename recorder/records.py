"""Walking over the records of an MCAP file, and telling a torn end from damage."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from zstandard import ZstdError

from recorder.errors import NotARecordingError, TornRecordingError

MAGIC: Final = b"\x89MCAP0\r\n"
_HEAD: Final = struct.Struct("<BQ")
_READERS: Final = {
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.METADATA: Metadata.read,
    Opcode.SCHEMA: Schema.read,
}
_DAMAGE: Final = (McapError, ZstdError, ValueError, struct.error, EOFError, RuntimeError, MemoryError)
"""What the MCAP and compression libraries raise on bytes that are not what they should be."""


def packed(*written: McapRecord) -> bytes:
    """The bytes of records as they stand in a file, one behind the other."""
    builder = RecordBuilder()
    for record in written:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap leaves this one unannotated
    return data


@dataclass(frozen=True)
class Record:
    """A record at the top level of a file: its place [bytes], its kind and its content."""

    offset: int
    opcode: int
    content: bytes

    @property
    def end(self) -> int:
        """The offset of the next record."""
        return self.offset + _HEAD.size + len(self.content)


def walk(file: Path) -> Iterator[Record]:
    """The records of a file up to its footer, which comes last.

    Raises TornRecordingError, after every whole record, where the file ends before its end, and NotARecordingError
    where the bytes are no MCAP file.
    """
    size = file.stat().st_size
    with file.open("rb") as stream:
        _check_magic(file, stream)
        while True:
            record = _read(file, stream, size)
            if record.opcode == Opcode.FOOTER and stream.read(len(MAGIC)) != MAGIC:
                raise TornRecordingError(file)
            yield record
            if record.opcode == Opcode.FOOTER:
                return


def _check_magic(file: Path, stream: BinaryIO) -> None:
    magic = stream.read(len(MAGIC))
    if magic == MAGIC:
        return
    if MAGIC.startswith(magic) or not magic.strip(b"\0"):
        raise TornRecordingError(file)
    raise NotARecordingError(file, "it does not begin as an MCAP file does")


def _read(file: Path, stream: BinaryIO, size: int) -> Record:
    offset = stream.tell()
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise TornRecordingError(file)
    opcode, length = _HEAD.unpack(head)
    if opcode == 0:
        raise _zeros_or_damage(file, stream, offset, head)
    if offset + _HEAD.size + length > size:
        raise TornRecordingError(file)
    return Record(offset, opcode, stream.read(length))


def _zeros_or_damage(file: Path, stream: BinaryIO, offset: int, head: bytes) -> Exception:
    """After a power cut a file may end in zeros that its system never replaced: torn. Anything else is damage."""
    while head:
        if head.strip(b"\0"):
            return NotARecordingError(file, f"it is damaged at byte {offset}: a record of kind 0 does not exist")
        head = stream.read(1 << 20)
    return TornRecordingError(file)


def parse(file: Path, record: Record) -> McapRecord | None:
    """A channel, chunk, metadata record or schema; None for any other kind. Raises NotARecordingError on damage."""
    reader = _READERS.get(record.opcode)  # type: ignore[call-overload]  # an opcode compares as an int
    if reader is None:
        return None
    try:
        parsed: McapRecord = reader(ReadDataStream(BytesIO(record.content)))
    except _DAMAGE as error:
        raise _damaged(file, record, error) from error
    return parsed


def unpack(file: Path, record: Record) -> list[McapRecord]:
    """What a chunk holds, its checksum verified. Raises NotARecordingError on damage."""
    chunk = parse(file, record)
    assert isinstance(chunk, Chunk)
    try:
        return breakup_chunk(chunk, validate_crc=True)
    except _DAMAGE as error:
        raise _damaged(file, record, error) from error


def message(file: Path, record: Record) -> Message:
    """A message outside of any chunk. Raises NotARecordingError on damage."""
    try:
        found: Message = Message.read(ReadDataStream(BytesIO(record.content)), len(record.content))
    except _DAMAGE as error:
        raise _damaged(file, record, error) from error
    return found


def _damaged(file: Path, record: Record, error: BaseException) -> NotARecordingError:
    return NotARecordingError(file, f"it is damaged at byte {record.offset}: {error or type(error).__name__}")
