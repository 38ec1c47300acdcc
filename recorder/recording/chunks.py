"""MCAP chunks at the speed of the network: packed once on arrival, compressed and indexed in one go.

The records are those of the MCAP specification; `mcap.records` writes the rare ones, and the two that occur by the
thousand (Message and MessageIndex) are packed here, because a general-purpose writer spends ten times as long on them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex

from recorder.recording.records import packed

MESSAGE: Final = struct.Struct("<BQHIQQ")
"""Opcode, length of what follows, channel, sequence, log time [ns], publish time [ns]; then the payload."""
MESSAGE_FIXED: Final = 22
"""Bytes of a message's content before its payload."""
OVERHEAD: Final = MESSAGE.size
_INDEX: Final = struct.Struct("<BQHI")
COMPRESSION_LEVEL: Final = 1
CHUNK_BYTES: Final = 1 << 20
"""Chunks are closed at this size."""


@dataclass
class Batch:
    """Messages on their way to a chunk: `pieces` alternate between packed heads and payloads."""

    pieces: list[bytes] = field(default_factory=list)
    channels: list[int] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    size_bytes: int = 0
    actions: int = 0
    """How many of the messages are demonstrated actions."""

    def add(self, channel: int, sequence: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Append a message; times in [ns]."""
        length = len(payload)
        self.pieces.append(MESSAGE.pack(Opcode.MESSAGE, MESSAGE_FIXED + length, channel, sequence, log_ns, publish_ns))
        self.pieces.append(payload)
        self.channels.append(channel)
        self.stamps_ns.append(log_ns)
        self.size_bytes += OVERHEAD + length

    def extend(self, other: Batch) -> None:
        """Append all messages of another batch."""
        self.pieces += other.pieces
        self.channels += other.channels
        self.stamps_ns += other.stamps_ns
        self.size_bytes += other.size_bytes
        self.actions += other.actions

    def __len__(self) -> int:
        return len(self.channels)


@dataclass(frozen=True)
class PackedChunk:
    """The bytes of a Chunk record and of its MessageIndex records, and how the summary points at them."""

    record: bytes
    indexes: bytes
    index: ChunkIndex
    counts: dict[int, int]
    """Messages by channel."""

    def at(self, offset: int) -> ChunkIndex:
        """The summary's record of this chunk if it is written at `offset` [bytes] of the file."""
        behind = offset + len(self.record)
        offsets = {channel: behind + relative for channel, relative in self.index.message_index_offsets.items()}
        return ChunkIndex(
            **{**vars(self.index), "chunk_start_offset": offset, "message_index_offsets": offsets},
        )


def pack_chunk(batch: Batch, compressor: zstandard.ZstdCompressor) -> PackedChunk:
    """Compress and index a batch of at least one message."""
    data = b"".join(batch.pieces)
    first, last = min(batch.stamps_ns), max(batch.stamps_ns)
    compressed = compressor.compress(data)
    record = packed(Chunk("zstd", compressed, last, first, zlib.crc32(data), len(data)))
    indexes, offsets, counts = _message_indexes(batch)
    index = ChunkIndex(
        chunk_length=len(record),
        chunk_start_offset=0,
        compression="zstd",
        compressed_size=len(compressed),
        message_end_time=last,
        message_index_length=len(indexes),
        message_index_offsets=offsets,
        message_start_time=first,
        uncompressed_size=len(data),
    )
    return PackedChunk(record, indexes, index, counts)


def _message_indexes(batch: Batch) -> tuple[bytes, dict[int, int], dict[int, int]]:
    """The MessageIndex records of a chunk, where each begins in them, and the number of messages by channel."""
    channels = np.array(batch.channels, dtype=np.uint16)
    entries = np.empty((len(batch), 2), dtype="<u8")
    entries[:, 0] = batch.stamps_ns
    entries[:, 1] = _offsets(batch.pieces)
    pieces: list[bytes] = []
    offsets: dict[int, int] = {}
    counts: dict[int, int] = {}
    length = 0
    for channel in np.unique(channels).tolist():
        body = entries[channels == channel].tobytes()
        head = _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(body), channel, len(body))
        pieces += (head, body)
        offsets[channel], counts[channel] = length, len(body) // 16
        length += len(head) + len(body)
    return b"".join(pieces), offsets, counts


def _offsets(pieces: Sequence[bytes]) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    """Where each message (a head and a payload) begins in the joined pieces [bytes]."""
    lengths = np.fromiter(map(len, pieces), dtype=np.uint64, count=len(pieces))
    ends = np.cumsum(lengths[0::2] + lengths[1::2])
    return np.concatenate([np.zeros(1, dtype=np.uint64), ends[:-1]])
