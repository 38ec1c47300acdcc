"""The end of an MCAP file: what it repeats of the rest, so that readers find their way."""

from __future__ import annotations

import zlib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from recorder.recording import records
from recorder.recording.chunks import PackedChunk


@dataclass
class Summary:
    """What the end of an MCAP file repeats of the rest."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=lambda: defaultdict(int))

    def add_chunk(self, packed: PackedChunk, offset: int) -> None:
        self.chunks.append(packed.at(offset))
        for channel, count in packed.counts.items():
            self.counts[channel] += count

    def messages(self) -> dict[str, int]:
        total: dict[str, int] = defaultdict(int)
        for channel, count in list(self.counts.items()):
            total[self.channels[channel].topic] += count
        return dict(sorted(total.items()))

    def statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self.chunks),
            message_count=sum(self.counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self.chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self.chunks), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )

    def tail(self, offset: int, crc: int) -> bytes:
        """The data section's end, the summary and the footer, for a data section that ends at `offset` [bytes] and has
        this checksum.
        """
        data_end = records.packed(DataEnd(data_section_crc=crc))
        start = offset + len(data_end)
        groups: dict[Opcode, Sequence[Any]] = {
            Opcode.SCHEMA: list(self.schemas.values()),
            Opcode.CHANNEL: list(self.channels.values()),
            Opcode.STATISTICS: [self.statistics()],
            Opcode.CHUNK_INDEX: self.chunks,
            Opcode.ATTACHMENT_INDEX: self.attachments,
            Opcode.METADATA_INDEX: self.metadata,
        }
        summary, offsets = b"", []
        for opcode, group in groups.items():
            data = records.packed(*group)
            if data:
                offsets.append(SummaryOffset(opcode, start + len(summary), len(data)))
            summary += data
        return data_end + _with_footer(summary + records.packed(*offsets), start, start + len(summary))


def _with_footer(summary: bytes, start: int, offsets_start: int) -> bytes:
    footer = records.packed(Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=0))
    unsigned = footer[:-4]
    crc = zlib.crc32(summary + unsigned)
    return summary + unsigned + crc.to_bytes(4, "little") + records.MAGIC
