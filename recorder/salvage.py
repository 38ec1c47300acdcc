"""What is whole in a torn or damaged recording, taken over record by record, and what is gone, in sentences."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, McapRecord, Message, Metadata, Schema

from recorder.errors import NotARecordingError, RecorderError, TornRecordingError
from recorder.paths import shown
from recorder.recording import DEMONSTRATION, Demonstrated, RecordingWriter, records
from recorder.wire import NS


class Salvage:
    """One damaged file. Looks it through at once; `copy` then takes over what is whole.

    `gone` are sentences on what is not, `cut_bytes` what at its end belonged to no whole record, `header` whose file it
    was (None where that is damaged).
    """

    def __init__(self, torn: Path) -> None:
        records.check_regular(torn)
        self.torn, self.size = torn, torn.stat().st_size
        self.gone: list[str] = []
        self.cut_bytes = 0
        self.header: Header | None = None
        self._metadata: dict[str, str] | None = None
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._is_whole = self._look_through()

    def demonstrated(self) -> Demonstrated:
        """What the file says of itself. Raises NotARecordingError where it does not, RecorderError if it is whole."""
        if self._is_whole:
            raise RecorderError(f"{shown(self.torn)} is whole; there is nothing to recover")
        if self._metadata is None:
            reason = next(self._wrong_sums(), f"it is torn before its metadata record {DEMONSTRATION}")
            raise NotARecordingError(self.torn, reason)
        return Demonstrated.from_metadata(self.torn, self._metadata)

    def copy(self, writer: RecordingWriter) -> None:
        """Take over every whole record."""
        strangers = 0
        for found in self._found():
            match found:
                case Channel():
                    self._adopt(found.id, writer)
                case Message():
                    if self._adopt(found.channel_id, writer):
                        m = found
                        writer.append(m.channel_id, m.sequence, m.log_time, m.publish_time, m.data)
                    else:
                        strangers += 1
                case Attachment():
                    writer.adopt_attachment(found)
                case Metadata() if found.name != DEMONSTRATION:
                    writer.adopt_metadata(found)
        writer.close_chunk()
        if strangers:
            self.gone.append(f"{strangers} messages are left out, since what tells their channel is gone")

    def _adopt(self, number: int, writer: RecordingWriter) -> bool:
        """Tell of a channel, if anything in the file does."""
        channel = self._channels.get(number)
        if channel is not None:
            writer.adopt(channel, self._schemas.get(channel.schema_id))
        return channel is not None

    def _look_through(self) -> bool:
        """Note what is told of the file, its summary included, and what is damaged; whether nothing is."""
        self._ended = False
        for found in self._everything():
            match found:
                case Header():
                    self.header = found
                case Channel():
                    self._channels.setdefault(found.id, found)
                case Schema():
                    self._schemas.setdefault(found.id, found)
                case Metadata() if found.name == DEMONSTRATION:
                    self._metadata = found.metadata
        if not self.gone and self._ended:
            self.gone += self._wrong_sums()
        return not self.gone and self._ended

    def _wrong_sums(self) -> Iterator[str]:
        """Why the file as a whole is not what its checksums tell, though each of its records can be read."""
        try:
            for _ in records.walk(self.torn):
                pass
        except TornRecordingError:
            return  # its end is missing, which is known already
        except NotARecordingError as error:
            yield error.reason

    def _everything(self) -> Iterator[McapRecord]:
        """Every record that can be read; what cannot is noted once, in `gone`."""
        for record in self._records():
            self._ended = self._ended or record.opcode == Opcode.FOOTER
            yield from self._contents(record, self.gone)

    def _found(self) -> Iterator[McapRecord]:
        """The same again, of the data section."""
        for record in self._records(noted=False):
            if record.opcode == Opcode.DATA_END:
                return  # the summary is written anew
            yield from self._contents(record, [])

    def _contents(self, record: records.Record, gone: list[str]) -> Iterator[McapRecord]:
        try:
            if record.opcode == Opcode.CHUNK:
                yield from records.unpack(record)
            elif record.opcode == Opcode.MESSAGE:
                yield records.message(record)
            elif (parsed := records.parse(record)) is not None:
                yield parsed
        except NotARecordingError as error:
            if not self._ends_in_zeros(record):
                gone.append(self._lost(record, error))

    def _records(self, noted: bool = True) -> Iterator[records.Record]:
        """The records at the top level; behind one whose head is damaged, from the next whole chunk on."""
        offset = end = len(records.MAGIC)
        while True:
            try:
                for record in records.walk(self.torn, offset):
                    end = record.end
                    yield record
                    if record.opcode == Opcode.FOOTER:
                        return  # what stands behind it belongs to another file
            except TornRecordingError:
                following = records.next_chunk(self.torn, end)
            except NotARecordingError as error:
                following = records.next_chunk(self.torn, end)
                if noted and following is None:
                    self.gone.append(error.reason)
            if following is None:
                if noted:
                    self.cut_bytes = self.size - end
                return
            if noted:
                self.gone.append(f"{following - end} bytes from byte {end} on are damaged and left out")
            offset = end = following

    def _lost(self, record: records.Record, error: NotARecordingError) -> str:
        """What of the recording a damaged record was."""
        if record.opcode != Opcode.CHUNK:
            return error.reason
        try:
            chunk = records.chunk_head(record)
            seconds = (chunk.message_end_time - chunk.message_start_time) / NS
            when = f", said to be {seconds:.1f} s from {chunk.message_start_time / NS:.3f} on"
        except NotARecordingError:
            when = ""
        return f"the chunk at byte {record.offset} is damaged and left out ({record.length} bytes{when})"

    def _ends_in_zeros(self, record: records.Record) -> bool:
        """Whether a record, and all after it, ends in zeros that its system never replaced, as after a power cut."""
        with self.torn.open("rb") as stream:
            stream.seek(record.end - 1)
            zeros = not any(block.strip(b"\0") for block in iter(lambda: stream.read(1 << 20), b""))
        self.cut_bytes = max(self.cut_bytes, self.size - record.offset) if zeros else self.cut_bytes
        return zeros
