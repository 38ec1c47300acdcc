"""Walking over the records of an MCAP file, and telling a torn end from damage.

Every checksum that the format offers is verified where it stands: a chunk's before it is unpacked, an attachment's, the
data section's at its end, the summary's at the footer. Lengths are compared with what is left before they are believed.
"""

from __future__ import annotations

import mmap
import stat
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, McapRecord, Message, Metadata, Schema

from recorder.errors import NotARecordingError, TornRecordingError

MAGIC: Final = b"\x89MCAP0\r\n"
MOST_UNPACKED: Final = 1 << 32
"""A chunk that says to hold more bytes than this is not unpacked."""
_HEAD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")
_READERS: Final = {
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.DATA_END: DataEnd.read,
    Opcode.FOOTER: Footer.read,
    Opcode.HEADER: Header.read,
    Opcode.METADATA: Metadata.read,
    Opcode.SCHEMA: Schema.read,
}
_KINDS: Final = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
_DAMAGE: Final = (
    McapError,
    zstandard.ZstdError,
    ArithmeticError,
    ValueError,
    struct.error,
    EOFError,
    RuntimeError,
    MemoryError,
)
"""What the MCAP and compression libraries raise on bytes that are not what they should be."""


class _Bounded(ReadDataStream):
    """Reads fields of a record's content and never more than it has: a length may be anything in a damaged one."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        if length > self._size - self.count:
            raise EOFError(f"a field of {length} bytes is longer than its record")
        data: bytes = super().read(length)
        return data


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


def walk(file: Path, offset: int = 0) -> Iterator[Record]:
    """The records of a file up to its footer, which comes last; from the `offset` of one of them on, if that is given,
    and without the checksums of sections then.

    Raises TornRecordingError, after every whole record, where the file ends before its end, and NotARecordingError
    where the bytes are no MCAP file, a checksum is wrong, or more bytes stand behind the end.
    """
    check_regular(file)
    size = file.stat().st_size
    with file.open("rb") as stream:
        if not offset:
            _check_magic(file, stream)
        sums = _Sums(zlib.crc32(MAGIC)) if not offset else None
        stream.seek(offset or len(MAGIC))
        while True:
            record = _read(file, stream, size)
            if record.opcode == Opcode.FOOTER and stream.read(len(MAGIC)) != MAGIC:
                raise TornRecordingError(file)
            if sums:
                sums.take(file, record)
            yield record
            if record.opcode == Opcode.FOOTER:
                _check_nothing_follows(file, stream, size)
                return


def check_regular(file: Path) -> None:
    """Raises NotARecordingError for what is no file: reading a named pipe or a device might never end."""
    mode = file.stat().st_mode
    if not stat.S_ISREG(mode):
        raise NotARecordingError(file, f"it is {_KINDS.get(stat.S_IFMT(mode), 'no file')}")


class _Sums:
    """The running checksum of the section that is being read; both sections tell theirs at their end."""

    def __init__(self, begun: int) -> None:
        self._sum = begun

    def take(self, file: Path, record: Record) -> None:
        """Raises NotARecordingError where a section's checksum is not that of its bytes."""
        head = _HEAD.pack(record.opcode, len(record.content))
        if record.opcode == Opcode.DATA_END:
            end = parse(file, record)
            assert isinstance(end, DataEnd)
            self._check(file, record, "data", end.data_section_crc, self._sum)
            self._sum = 0
            return
        if record.opcode == Opcode.FOOTER:
            footer = parse(file, record)
            assert isinstance(footer, Footer)
            behind = zlib.crc32(record.content[:16], zlib.crc32(head, self._sum))
            self._check(file, record, "summary", footer.summary_crc, behind)
            return
        self._sum = zlib.crc32(record.content, zlib.crc32(head, self._sum))

    @staticmethod
    def _check(file: Path, record: Record, section: str, told: int, found: int) -> None:
        if told not in (0, found):
            raise _damaged(file, record, f"the checksum of its {section} section is not that of its bytes")


def _check_magic(file: Path, stream: BinaryIO) -> None:
    magic = stream.read(len(MAGIC))
    if magic == MAGIC:
        return
    if MAGIC.startswith(magic) or not magic.strip(b"\0"):
        raise TornRecordingError(file)
    raise NotARecordingError(file, "it does not begin as an MCAP file does")


def _check_nothing_follows(file: Path, stream: BinaryIO, size: int) -> None:
    end = stream.tell()
    if end == size:
        return
    what = "another MCAP file" if stream.read(len(MAGIC)) == MAGIC else f"{size - end} bytes more"
    raise NotARecordingError(
        file, f"behind its end, at byte {end}, comes {what}; `treewright recover` saves what comes before"
    )


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
    """A record of a kind that holds or describes data; None for any other kind. What a newer writer put behind the
    known fields is skipped. Raises NotARecordingError on damage, and for an attachment whose checksum is wrong.
    """
    reader = _READERS.get(record.opcode)  # type: ignore[call-overload]  # an opcode compares as an int
    if reader is None:
        return None
    try:
        stream = _Bounded(record.content)
        parsed: McapRecord = reader(stream)
        _check_attachment(parsed, record.content, stream.count)
    except _DAMAGE as error:
        raise _damaged(file, record, error) from error
    return parsed


def _check_attachment(parsed: McapRecord, content: bytes, read: int) -> None:
    if isinstance(parsed, Attachment):
        told = int.from_bytes(content[read - 4 : read], "little")
        if told not in (0, zlib.crc32(content[: read - 4])):
            raise ValueError(f"the checksum of the attachment {parsed.name!r} is not that of its bytes")


def unpack(file: Path, record: Record) -> list[McapRecord]:
    """The channels, schemas and messages that a chunk holds, its checksum verified.

    Raises NotARecordingError on damage.
    """
    chunk = parse(file, record)
    assert isinstance(chunk, Chunk)
    try:
        return list(_inside(file, record, _unpacked(chunk)))
    except _DAMAGE as error:
        raise _damaged(file, record, error) from error


def _unpacked(chunk: Chunk) -> bytes:
    """Raises what `_DAMAGE` names where the bytes are not those that the chunk tells of."""
    size = chunk.uncompressed_size
    if size > MOST_UNPACKED:
        raise ValueError(f"a chunk says to hold {size} bytes")
    match chunk.compression:
        case "zstd":
            data = _unpacked_zstd(chunk.data, size) if chunk.data else b""
        case "lz4":
            data = bytes(lz4.frame.decompress(chunk.data))
        case "":
            data = chunk.data
        case other:
            raise ValueError(f"its compression {other[:40]!r} is none that MCAP knows")
    if len(data) != size:
        raise ValueError(f"a chunk holds {len(data)} bytes and not the {size} that it says")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("the checksum of a chunk is not that of its bytes")
    return data


def _unpacked_zstd(data: bytes, size: int) -> bytes:
    if zstandard.frame_content_size(data) not in (-1, size):
        raise ValueError(f"a chunk holds another number of bytes than the {size} that it says")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1))


def _inside(file: Path, record: Record, data: bytes) -> Iterator[McapRecord]:
    """The records in a chunk's unpacked bytes; kinds that are not known are skipped."""
    offset = 0
    while offset < len(data):
        opcode, length = _HEAD.unpack_from(data, offset)
        begin, offset = offset + _HEAD.size, offset + _HEAD.size + length
        if offset > len(data):
            raise EOFError(f"a record of {length} bytes is longer than its chunk")
        if opcode == Opcode.MESSAGE:
            yield _message(data, begin, offset)
        elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
            found = parse(file, Record(record.offset, opcode, data[begin:offset]))
            assert found is not None
            yield found


def message(file: Path, record: Record) -> Message:
    """A message outside of any chunk. Raises NotARecordingError on damage."""
    try:
        return _message(record.content, 0, len(record.content))
    except _DAMAGE as error:
        raise _damaged(file, record, error) from error


def _message(data: bytes, begin: int, end: int) -> Message:
    if end - begin < _MESSAGE.size:
        raise EOFError("a message is shorter than its head")
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, begin)
    return Message(
        channel_id=channel,
        log_time=log_time,
        data=data[begin + _MESSAGE.size : end],
        publish_time=publish_time,
        sequence=sequence,
    )


def next_chunk(file: Path, offset: int) -> int | None:
    """The offset of the next whole chunk from a byte on, by what a chunk looks like; None if there is none.

    For what stands behind a record whose length is wrong. A chunk without a checksum is not believed here.
    """
    if offset >= file.stat().st_size:
        return None
    with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        while (offset := content.find(bytes((Opcode.CHUNK,)), offset)) >= 0:
            if _is_chunk(file, content, offset):
                return offset
            offset += 1
    return None


def _is_chunk(file: Path, content: mmap.mmap, offset: int) -> bool:
    behind = offset + _HEAD.size
    if behind > len(content):
        return False
    _, length = _HEAD.unpack(content[offset:behind])
    if length < 40 or length > len(content) - behind:
        return False
    record = Record(offset, Opcode.CHUNK, content[behind : behind + length])
    try:
        chunk = parse(file, record)
        assert isinstance(chunk, Chunk)
        return chunk.uncompressed_crc != 0 and bool(unpack(file, record))
    except NotARecordingError:
        return False


def _damaged(file: Path, record: Record, error: BaseException | str) -> NotARecordingError:
    what = error if isinstance(error, str) else " ".join(str(error).split()) or type(error).__name__
    return NotARecordingError(file, f"it is damaged at byte {record.offset}: {what}")
