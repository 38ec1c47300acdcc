"""Walking over the records of an MCAP file, and telling a torn end from damage.

Every checksum that the format offers is verified where it stands: a chunk's before it is unpacked, an attachment's, the
data section's at its end, the summary's at the footer. Lengths are compared with what is left before they are believed.
What is large is not held, but read again where it is needed, so that memory does not grow with it.
"""

from __future__ import annotations

import io
import mmap
import stat
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, BinaryIO, Final, cast

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, McapRecord, Message, Metadata, Schema

from recorder.errors import NotARecordingError, TornRecordingError

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

MAGIC: Final = b"\x89MCAP0\r\n"
LARGE: Final = 16 << 20
"""Records of more bytes than this, and chunks that hold more, are not held in memory."""
BLOCK: Final = 1 << 20
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
    """Reads fields of `size` bytes and never more than they are: a length may be anything in a damaged record."""

    def __init__(self, stream: IO[bytes], size: int, summed: bool = False) -> None:
        super().__init__(stream, calculate_crc=summed)
        self._size = size

    @property
    def left(self) -> int:
        """How many bytes are not read yet."""
        return self._size - self.count

    def read(self, length: int) -> bytes:
        if length > self.left:
            raise EOFError(f"a field of {length} bytes is longer than its record")
        data: bytes = super().read(length)
        if len(data) < length:
            raise EOFError(f"{length - len(data)} bytes are missing")
        return data

    def blocks(self, length: int) -> Iterator[bytes]:
        """So many bytes, in pieces."""
        if length > self.left:
            raise EOFError(f"a field of {length} bytes is longer than its record")
        while length:
            yield self.read(taken := min(length, BLOCK))
            length -= taken


class _Window(io.RawIOBase):
    """The next `size` bytes of a stream as a stream of their own, for what reads until the end."""

    def __init__(self, stream: _Bounded, size: int) -> None:
        super().__init__()
        self._stream, self._left = stream, size

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        view = memoryview(buffer).cast("B")
        data = self._stream.read(min(len(view), self._left))
        view[: len(data)] = data
        self._left -= len(data)
        return len(data)


def packed(*written: McapRecord) -> bytes:
    """The bytes of records as they stand in a file, one behind the other."""
    builder = RecordBuilder()
    for record in written:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap leaves this one unannotated
    return data


@dataclass(frozen=True)
class Record:
    """A record at the top level of a file: its place and length [bytes], its kind, and its content if that is held."""

    file: Path
    offset: int
    opcode: int
    length: int
    held: bytes | None

    @property
    def end(self) -> int:
        """The offset of the next record."""
        return self.offset + _HEAD.size + self.length

    @property
    def content(self) -> bytes:
        """All of it, however large it is."""
        with self.opened() as stream:
            return self.held if self.held is not None else stream.read(self.length)

    @contextmanager
    def opened(self, summed: bool = False) -> Iterator[_Bounded]:
        """To read its fields one by one."""
        if self.held is not None:
            yield _Bounded(BytesIO(self.held), self.length, summed)
            return
        with self.file.open("rb") as stream:
            stream.seek(self.offset + _HEAD.size)
            yield _Bounded(stream, self.length, summed)


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
                sums.take(record)
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

    def take(self, record: Record) -> None:
        """Raises NotARecordingError where a section's checksum is not that of its bytes."""
        head = _HEAD.pack(record.opcode, record.length)
        if record.opcode == Opcode.DATA_END:
            self._check(record, "data", cast(DataEnd, parse(record)).data_section_crc, self._sum)
            self._sum = 0
            return
        if record.opcode == Opcode.FOOTER:
            told = cast(Footer, parse(record)).summary_crc
            with record.opened() as stream:
                self._check(record, "summary", told, zlib.crc32(stream.read(16), zlib.crc32(head, self._sum)))
            return
        self._sum = zlib.crc32(head, self._sum)
        with record.opened() as stream:
            for block in stream.blocks(record.length):
                self._sum = zlib.crc32(block, self._sum)

    @staticmethod
    def _check(record: Record, section: str, told: int, found: int) -> None:
        if told not in (0, found):
            raise _damaged(record, f"the checksum of its {section} section is not that of its bytes")


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
    if length <= LARGE:
        return Record(file, offset, opcode, length, stream.read(length))
    stream.seek(length, io.SEEK_CUR)
    return Record(file, offset, opcode, length, None)


def _zeros_or_damage(file: Path, stream: BinaryIO, offset: int, head: bytes) -> Exception:
    """After a power cut a file may end in zeros that its system never replaced: torn. Anything else is damage."""
    while head:
        if head.strip(b"\0"):
            return NotARecordingError(file, f"it is damaged at byte {offset}: a record of kind 0 does not exist")
        head = stream.read(1 << 20)
    return TornRecordingError(file)


def parse(record: Record) -> McapRecord | None:
    """A record of a kind that holds or describes data; None for any other kind. What a newer writer put behind the
    known fields is skipped. Raises NotARecordingError on damage, and for an attachment whose checksum is wrong.
    """
    reader = _READERS.get(record.opcode)  # type: ignore[call-overload]  # an opcode compares as an int
    if reader is None:
        return None
    if record.opcode == Opcode.ATTACHMENT:
        check_attachment(record)
    try:
        with record.opened() as stream:
            return cast(McapRecord, reader(stream))
    except _DAMAGE as error:
        raise _damaged(record, error) from error


def check_attachment(record: Record) -> None:
    """Verify the checksum of an attachment without holding it. Raises NotARecordingError."""
    try:
        with record.opened(summed=True) as stream:
            stream.read(16)
            name, _ = stream.read_prefixed_string(), stream.read_prefixed_string()
            for _ in stream.blocks(stream.read8()):
                pass
            found = stream.checksum()
            if stream.read4() not in (0, found):
                raise ValueError(f"the checksum of the attachment {name!r} is not that of its bytes")
    except _DAMAGE as error:
        raise _damaged(record, error) from error


def unpack(record: Record) -> Iterator[McapRecord]:
    """The channels, schemas and messages that a chunk holds; before the first one comes, all of it was verified.

    A large chunk is read twice. Raises NotARecordingError on damage.
    """
    try:
        if record.length <= LARGE and chunk_head(record).uncompressed_size <= LARGE:
            yield from list(_inside(record, _unpacked(cast(Chunk, parse(record)))))
            return
        for _ in _streamed(record, summed=True):
            pass
        yield from _streamed(record, summed=False)
    except _DAMAGE as error:
        raise _damaged(record, error) from error


def chunk_head(record: Record) -> Chunk:
    """What a chunk tells of itself, without its data. Raises NotARecordingError on damage."""
    try:
        with record.opened() as stream:
            return _chunk_head(stream)
    except _DAMAGE as error:
        raise _damaged(record, error) from error


def _chunk_head(stream: _Bounded) -> Chunk:
    begin, end, size, crc = stream.read8(), stream.read8(), stream.read8(), stream.read4()
    return Chunk(stream.read_prefixed_string(), b"", end, begin, crc, size)


def _streamed(record: Record, summed: bool) -> Iterator[McapRecord]:
    """The records in a chunk, of which one at a time is held. Raises what `_DAMAGE` names."""
    with record.opened() as stream:
        head, length = _chunk_head(stream), stream.read8()
        if length > stream.left:
            raise EOFError(f"a field of {length} bytes is longer than its record")
        with io.BufferedReader(_decompressing(head.compression, _Window(stream, length)), BLOCK) as inside:
            data = _Bounded(inside, head.uncompressed_size, summed)
            while data.left:
                opcode, size = _HEAD.unpack(data.read(_HEAD.size))
                yield from _one_inside(record, opcode, data.read(size))
            if inside.read(1):
                raise ValueError(f"a chunk holds more than the {head.uncompressed_size} bytes that it says")
    if summed and head.uncompressed_crc not in (0, data.checksum()):
        raise ValueError("the checksum of a chunk is not that of its bytes")


def _decompressing(compression: str, packed_: _Window) -> io.RawIOBase:
    match compression:
        case "zstd":
            return cast(io.RawIOBase, zstandard.ZstdDecompressor().stream_reader(cast(IO[bytes], packed_)))
        case "lz4":
            return cast(io.RawIOBase, lz4.frame.LZ4FrameFile(packed_))
        case "":
            return packed_
        case other:
            raise ValueError(f"its compression {other[:40]!r} is none that MCAP knows")


def _unpacked(chunk: Chunk) -> bytes:
    """Raises what `_DAMAGE` names where the bytes are not those that the chunk tells of."""
    size = chunk.uncompressed_size
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


def _inside(record: Record, data: bytes) -> Iterator[McapRecord]:
    """The records in a chunk's unpacked bytes; kinds that are not known are skipped."""
    offset = 0
    while offset < len(data):
        opcode, length = _HEAD.unpack_from(data, offset)
        begin, offset = offset + _HEAD.size, offset + _HEAD.size + length
        if offset > len(data):
            raise EOFError(f"a record of {length} bytes is longer than its chunk")
        if opcode == Opcode.MESSAGE:
            yield _message(data, begin, offset)
        else:
            yield from _one_inside(record, opcode, data[begin:offset])


def _one_inside(record: Record, opcode: int, content: bytes) -> Iterator[McapRecord]:
    if opcode == Opcode.MESSAGE:
        yield _message(content, 0, len(content))
    elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
        found = parse(Record(record.file, record.offset, opcode, len(content), content))
        assert found is not None
        yield found


def message(record: Record) -> Message:
    """A message outside of any chunk. Raises NotARecordingError on damage."""
    try:
        return _message(record.content, 0, record.length)
    except _DAMAGE as error:
        raise _damaged(record, error) from error


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
    record = Record(file, offset, Opcode.CHUNK, length, None)
    try:
        return chunk_head(record).uncompressed_crc != 0 and any(True for _ in unpack(record))
    except NotARecordingError:
        return False


def _damaged(record: Record, error: BaseException | str) -> NotARecordingError:
    what = error if isinstance(error, str) else " ".join(str(error).split()) or type(error).__name__
    return NotARecordingError(record.file, f"it is damaged at byte {record.offset}: {what}")
