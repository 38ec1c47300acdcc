"""The writer of recordings."""

from __future__ import annotations

import hashlib
import os
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self

import zstandard
from mcap.records import Attachment, AttachmentIndex, Channel, Header, Metadata, MetadataIndex, Schema

from recorder.durable import sync_folder
from recorder.errors import RecorderError
from recorder.paths import shown
from recorder.recording import records
from recorder.recording.chunks import CHUNK_BYTES, COMPRESSION_LEVEL, Batch, pack_chunk
from recorder.recording.demonstrated import DEMONSTRATION, Demonstrated
from recorder.recording.schemas import message_encoding, schema_of
from recorder.recording.summary import Summary
from recorder.wire import ENCODINGS

UNFINISHED: Final = ".part"
"""Ends the name of a recording that is still being written."""
LIBRARY: Final = "treewright"


@dataclass(frozen=True)
class Finished:
    """A recording that is whole: its path, messages by topic, and the digest of its bytes."""

    file: Path
    messages: Mapping[str, int]
    sha256: str


class RecordingWriter:
    """Writes one recording beside its place (`<file>.part`) and renames it there when it is whole.

    `write` is for everyone; the recorder hands over batches that it packed on arrival (`write_batch`). `sync` makes
    durable what was written. `finish` closes, verifies by reading back, and renames; a block that ends without it, or
    by an exception, leaves the unfinished file, which `treewright recover` completes. Not safe for threads, except
    that `sync` may run beside the rest.

    Raises OSError as the file system does; RecorderError if the file exists or reads back otherwise than written.
    """

    def __init__(self, file: Path, demonstrated: Demonstrated, header: Header | None = None) -> None:
        """`header` tells whose file is written anew: its profile and library are kept."""
        self.file, self.demonstrated = file, demonstrated
        self.unfinished = file.with_name(file.name + UNFINISHED)
        if file.exists():
            raise RecorderError(f"{shown(file)} exists already; a recording is never overwritten")
        file.parent.mkdir(parents=True, exist_ok=True)
        self._stream: IO[bytes] = self.unfinished.open("xb", buffering=0)
        self._batch = Batch()
        self._summary = Summary()
        self._compressor = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
        self._crc = 0
        self._offset = 0
        self._ids: dict[tuple[str, str], int] = {}
        self._begin(header or Header(profile="", library=LIBRARY))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.close()

    @property
    def size_bytes(self) -> int:
        """Bytes written so far."""
        return self._offset

    @property
    def messages(self) -> dict[str, int]:
        """Messages written so far by topic."""
        return self._summary.messages()

    def write(
        self,
        topic: str,
        payload: bytes,
        log_ns: int,
        publish_ns: int | None = None,
        sequence: int = 0,
        encoding: str | None = None,
    ) -> None:
        """Append a message; times in [ns]. `encoding` is its Zenoh encoding, by default the contract's."""
        encoding = ENCODINGS.get(topic, "zenoh/bytes") if encoding is None else encoding
        if (topic, encoding) not in self._ids:
            self._ids[topic, encoding] = len(self._ids) + 1
            self.add_channel(self._ids[topic, encoding], topic, encoding)
        self.append(self._ids[topic, encoding], sequence, log_ns, log_ns if publish_ns is None else publish_ns, payload)

    def append(self, channel: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Append a message of a channel that was told before; times in [ns]."""
        self._batch.add(channel, sequence, log_ns, publish_ns, payload)
        if self._batch.size_bytes >= CHUNK_BYTES:
            self.close_chunk()

    def close_chunk(self) -> None:
        """Write what `write` has gathered as one chunk."""
        batch, self._batch = self._batch, Batch()
        if len(batch):
            self.write_batch(batch)

    def add_channel(self, channel: int, topic: str, encoding: str) -> None:
        """Tell of a channel, before its first message; `encoding` is Zenoh's. A second time changes nothing."""
        if channel in self._summary.channels:
            return
        schema = schema_of(topic)
        described = Channel(
            id=channel,
            topic=topic,
            message_encoding=message_encoding(topic, encoding),
            metadata={"zenoh_encoding": encoding},
            schema_id=schema.id if schema else 0,
        )
        self.adopt(described, schema)

    def adopt(self, channel: Channel, schema: Schema | None) -> None:
        """Tell of a channel as another file has it, number, schema and all. A second time changes nothing."""
        if channel.id in self._summary.channels:
            return
        if schema and schema.id not in self._summary.schemas:
            self._record(schema)
            self._summary.schemas[schema.id] = schema
        self._record(channel)
        self._summary.channels[channel.id] = channel

    def adopt_metadata(self, metadata: Metadata) -> None:
        """Write a metadata record as it is."""
        offset = self._offset
        self._record(metadata)
        self._summary.metadata.append(MetadataIndex(offset=offset, length=self._offset - offset, name=metadata.name))

    def adopt_attachment(self, attachment: Attachment) -> None:
        """Write an attachment as it is."""
        offset, a = self._offset, attachment
        self._record(attachment)
        length = self._offset - offset
        index = AttachmentIndex(offset, length, a.log_time, a.create_time, len(a.data), a.name, a.media_type)
        self._summary.attachments.append(index)

    def write_batch(self, batch: Batch) -> None:
        """Write a batch of at least one message as one chunk; its channels were told before."""
        packed, offset = pack_chunk(batch, self._compressor), self._offset
        self._write(packed.record + packed.indexes)
        self._summary.add_chunk(packed, offset)

    def sync(self) -> None:
        """Make durable what was written before the call."""
        os.fdatasync(self._stream.fileno())

    def finish(self, demonstrated: Demonstrated | None = None) -> Finished:
        """Close, make durable, verify by reading back, rename. The record of what was demonstrated is written last."""
        self.close_chunk()
        self._metadata(demonstrated or self.demonstrated)
        self._write(self._summary.tail(self._offset, self._crc))
        os.fsync(self._stream.fileno())
        self._forget_cached()
        self._stream.close()
        sha256 = self._verify()
        self.unfinished.rename(self.file)
        sync_folder(self.file.parent)
        return Finished(self.file, self.messages, sha256)

    def _verify(self) -> str:
        """Read the file back; its digest if it is what was written."""
        digest, crc, size = hashlib.sha256(), 0, 0
        with self.unfinished.open("rb") as stream:
            for block in iter(lambda: stream.read(1 << 20), b""):
                digest.update(block)
                crc = zlib.crc32(block, crc)
                size += len(block)
        if (crc, size) != (self._crc, self._offset):
            raise RecorderError(f"{self.unfinished} reads back otherwise than it was written; check the disk")
        return digest.hexdigest()

    def _begin(self, header: Header) -> None:
        self._write(records.MAGIC)
        self._record(header)
        self._metadata(replace(self.demonstrated, outcome="unknown"))
        self.sync()
        sync_folder(self.file.parent)

    def _metadata(self, demonstrated: Demonstrated) -> None:
        self.adopt_metadata(Metadata(name=DEMONSTRATION, metadata=demonstrated.to_metadata()))

    def _record(self, record: Any) -> None:
        self._write(records.packed(record))

    def _write(self, data: bytes) -> None:
        """Append all of it or, where the disk does not take it, nothing: what came before stays whole."""
        before, crc = self._offset, self._crc
        view = memoryview(data)
        try:
            while view:
                taken = os.write(self._stream.fileno(), view)
                self._crc = zlib.crc32(view[:taken], self._crc)
                self._offset += taken
                view = view[taken:]
        except OSError:
            self._offset, self._crc = before, crc
            os.ftruncate(self._stream.fileno(), before)
            os.lseek(self._stream.fileno(), before, os.SEEK_SET)
            raise

    def _forget_cached(self) -> None:
        """So that verification reads what the disk holds, where the system follows the advice."""
        os.posix_fadvise(self._stream.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
