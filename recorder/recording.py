"""The format of a recording (CONTRACT, section 2): its words, its writer and its reader.

MCAP file
├── metadata `treewright.demonstration`   written first (outcome unknown) and last; the last one wins
├── /poses     protobuf  foxglove.FrameTransforms
├── /gripper   json      treewright.GripperState
├── /action    json      treewright.DemonstratedAction
└── /…         any other key of the cell, byte for byte; `zenoh_encoding` in the channel's metadata
"""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self, TypeVar, cast

import numpy as np
import zstandard
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from learner.model import ActionPress, GripperSample, Recording, Scene, Track
from recorder import records, wire
from recorder.chunks import COMPRESSION_LEVEL, Batch, PackedChunk, pack_chunk
from recorder.clocks import Arrived, Straight, straighten
from recorder.errors import NotARecordingError, PartMissingError, PayloadError, RecorderError
from recorder.notices import Notices
from recorder.paths import shown
from recorder.wire import ACTION, ENCODINGS, GRIPPER, POSES, Sighting

CONTRACT: Final = "1"
DEMONSTRATION: Final = "treewright.demonstration"
"""The name of the metadata record."""
CHUNK_BYTES: Final = 1 << 20
UNFINISHED: Final = ".part"
"""Ends the name of a recording that is still being written."""
LIBRARY: Final = "treewright"


# --- the words ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Demonstrated:
    """The metadata record of a recording: what was demonstrated, by whom, where, and how it ended.

    `part` numbers the parts of a split demonstration from 1; `continued` says that another part follows. `scene` is
    the JSON text of the contract. `more` holds every further entry of the record, kept as it is.
    """

    demonstration_id: str
    task: str
    user: str
    cell: str
    base_frame: str
    end_effector_frame: str
    objects: tuple[str, ...]
    outcome: str = "unknown"
    start_ns: int | None = None
    messages_lost: Mapping[str, int | None] | None = None
    part: int | None = None
    continued: bool = False
    scene: str | None = None
    gaps: tuple[str, ...] = ()
    more: Mapping[str, str] = field(default_factory=dict)

    def to_metadata(self) -> dict[str, str]:
        """The entries of the record, all strings."""
        optional = {
            "start_ns": self.start_ns,
            "messages_lost": None if self.messages_lost is None else json.dumps(self.messages_lost, sort_keys=True),
            "part": self.part,
            "continued": "true" if self.continued else None,
            "scene": self.scene,
            "gaps": json.dumps(self.gaps) if self.gaps else None,
        }
        return {
            **self.more,
            "contract": CONTRACT,
            **{name: getattr(self, name) for name in _REQUIRED_STRINGS},
            "objects": json.dumps(self.objects),
            **{name: str(value) for name, value in optional.items() if value is not None},
        }

    @staticmethod
    def from_metadata(file: Path, metadata: Mapping[str, str]) -> Demonstrated:
        """The record as read from `file`. Raises NotARecordingError for what the contract does not admit."""
        missing = [name for name in ("contract", *_REQUIRED_STRINGS, "objects") if name not in metadata]
        if missing:
            raise NotARecordingError(file, f"its record {DEMONSTRATION} lacks {', '.join(missing)}")
        if metadata["contract"] != CONTRACT:
            raise NotARecordingError(
                file, f"it keeps version {metadata['contract']!r} of the contract; this program knows {CONTRACT}"
            )
        return Demonstrated(
            **{name: metadata[name] for name in _REQUIRED_STRINGS},
            objects=_names(file, metadata["objects"]),
            start_ns=_whole_number(file, "start_ns", metadata.get("start_ns")),
            messages_lost=_lost(file, metadata.get("messages_lost")),
            part=_whole_number(file, "part", metadata.get("part")),
            continued=metadata.get("continued") == "true",
            scene=metadata.get("scene") or None,
            gaps=_sentences(metadata.get("gaps")),
            more={name: text for name, text in metadata.items() if name not in _KNOWN},
        )


_REQUIRED_STRINGS: Final = (
    "demonstration_id", "task", "user", "cell", "base_frame", "end_effector_frame", "outcome",
)  # fmt: skip
_KNOWN: Final = {
    "contract", *_REQUIRED_STRINGS, "objects", "start_ns", "messages_lost", "part", "continued", "scene", "gaps",
}  # fmt: skip


def _json(file: Path, what: str, text: str | bytes) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise NotARecordingError(file, f"{what} is not JSON: {error}") from error


def _names(file: Path, text: str) -> tuple[str, ...]:
    names = _json(file, "`objects` of its record", text)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise NotARecordingError(file, f"`objects` of its record is not a JSON array of names: {text[:80]}")
    return tuple(names)


def _whole_number(file: Path, name: str, text: str | None) -> int | None:
    if not text:
        return None
    if not text.isascii() or not text.isdigit() or int(text) >= 2**63:
        raise NotARecordingError(file, f"`{name}` of its record is not a whole number: {text[:80]!r}")
    return int(text)


def _lost(file: Path, text: str | None) -> dict[str, int | None] | None:
    if not text:
        return None
    lost = _json(file, "`messages_lost` of its record", text)
    counts = isinstance(lost, dict) and all(count is None or type(count) is int for count in lost.values())
    if not counts:
        raise NotARecordingError(file, f"`messages_lost` of its record does not count by topic: {text[:80]}")
    return cast(dict[str, int | None], lost)


def _sentences(text: str | None) -> tuple[str, ...]:
    """Our own addition to the record; another writer may mean anything by the word, so it is never refused."""
    try:
        sentences = json.loads(text or "[]")
    except ValueError:
        return (text or "",)
    return tuple(map(str, sentences)) if isinstance(sentences, list) else (str(sentences),)


def parse_scene(text: str) -> Scene:
    """The scene of the contract, section 2. Raises ValueError with what is wrong with it."""
    try:
        return Scene.of_data(json.loads(text))
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"the scene is not as the contract's section 2 has it: {error}") from error


def file_descriptor_set(message: type[FrameTransforms]) -> bytes:
    """The FileDescriptorSet of a protobuf message, dependencies first: what an MCAP reader needs to decode it."""
    found = FileDescriptorSet()
    seen: set[str] = set()

    def add(descriptor: FileDescriptor) -> None:
        if descriptor.name in seen:
            return
        seen.add(descriptor.name)
        for dependency in descriptor.dependencies:
            add(dependency)
        descriptor.CopyToProto(found.file.add())

    add(message.DESCRIPTOR.file)
    return found.SerializeToString()


_GRIPPER_SCHEMA: Final = {
    "title": "treewright.GripperState",
    "type": "object",
    "properties": {
        "stamp_ns": {"type": "integer", "description": "nanoseconds since the Unix epoch"},
        "state": {"enum": ["open", "closed"]},
        "width_m": {"type": ["number", "null"], "description": "metres between the fingers"},
    },
    "required": ["stamp_ns", "state"],
}
_ACTION_SCHEMA: Final = {
    "title": "treewright.DemonstratedAction",
    "type": "object",
    "properties": {
        "stamp_ns": {"type": "integer", "description": "the moment the operator chose it, in ns since the Unix epoch"},
        "type": {"enum": ["pick", "place", "drop"]},
        "object": {"type": ["string", "null"]},
    },
    "required": ["stamp_ns", "type"],
}


def _schema(topic: str) -> Schema | None:
    """The schema of a topic of the contract; other topics have none."""
    if topic == POSES:
        return Schema(
            id=1, name="foxglove.FrameTransforms", encoding="protobuf", data=file_descriptor_set(FrameTransforms)
        )
    known = {GRIPPER: (2, _GRIPPER_SCHEMA), ACTION: (3, _ACTION_SCHEMA)}
    if topic not in known:
        return None
    number, schema = known[topic]
    text = json.dumps(schema, sort_keys=True).encode()
    return Schema(id=number, name=str(schema["title"]), encoding="jsonschema", data=text)


_MEDIA: Final = (("application/json", "json"), ("text/json", "json"), ("application/protobuf", "protobuf"))


def _message_encoding(topic: str, zenoh_encoding: str) -> str:
    """MCAP's word for a payload. Without a schema readers can decode JSON alone, so the rest goes by its media type."""
    if topic in ENCODINGS:
        return "protobuf" if topic == POSES else "json"
    media = zenoh_encoding.partition(";")[0]
    return dict(_MEDIA[:2]).get(media, media)


# --- the writer -----------------------------------------------------------------------------------------------------


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
        self._summary = _Summary()
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
        schema = _schema(topic)
        described = Channel(
            id=channel,
            topic=topic,
            message_encoding=_message_encoding(topic, encoding),
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


@dataclass
class _Summary:
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


def sync_folder(folder: Path) -> None:
    """Make durable which names a folder holds."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


# --- the reader -----------------------------------------------------------------------------------------------------


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


def sha256_of(files: Sequence[Path]) -> str:
    """The digest of the files' bytes, in this order. Raises NotARecordingError for a pipe or a device."""
    digest = hashlib.sha256()
    for file in files:
        records.check_regular(file)
        with file.open("rb") as stream:
            for block in iter(lambda: stream.read(1 << 20), b""):
                digest.update(block)
    return digest.hexdigest()


def sort_parts(files: Sequence[Path]) -> list[Path]:
    """The parts of one split demonstration in their order, or the one file of an unsplit one.

    Raises PartMissingError if one is missing, RecorderError if they are not parts of one demonstration.
    """
    headers = {file: read_header(file) for file in files}
    ordered = sorted(files, key=lambda file: headers[file].part or 1)
    numbers = [headers[file].part or 1 for file in ordered]
    identifier = headers[ordered[0]].demonstration_id
    if len({header.demonstration_id for header in headers.values()}) > 1 or len(set(numbers)) < len(numbers):
        raise RecorderError(f"{', '.join(map(str, files))} are not the parts of one demonstration")
    expected = range(1, len(numbers) + (2 if headers[ordered[-1]].continued else 1))
    missing = next((number for number in expected if number not in numbers), None)
    if missing is not None:
        raise PartMissingError(identifier, numbers, missing)
    return ordered


def all_parts(files: Sequence[Path]) -> list[Path]:
    """The parts of one demonstration in their order; of a single part given, those that lie beside it too.

    Raises as `sort_parts`.
    """
    first = read_header(files[0])
    if len(files) > 1 or first.part is None:
        return sort_parts(files)
    return sort_parts([file for file in sorted(files[0].parent.glob("*.mcap")) if _is_part(file, first)] or files)


def _is_part(file: Path, of: Demonstrated) -> bool:
    try:
        return read_header(file).demonstration_id == of.demonstration_id
    except (RecorderError, OSError):
        return False  # whatever it is, it is no part of this one


def read_recording(paths: Sequence[Path]) -> Recording:
    """The recording in one file, or in the parts of a split one (given in any order).

    Poses relative to another frame than the base are no sightings; messages and poses that say nothing (no finite
    position, no rotation, no stamp) are left out, and `notes` tell of them. Of exactly equal presses one is kept. All
    is on one timeline, also where clocks were set (see recorder.clocks).

    Raises NotARecordingError for a file that is none or is damaged, TornRecordingError for one that ends before its
    end, PartMissingError for a split one that is not all there, OSError if a file cannot be read.
    """
    if not paths:
        raise RecorderError("a recording is at least one file")
    files = sort_parts(paths)
    parts = [_Part(file) for file in files]
    first, last = parts[0].demonstrated, parts[-1].demonstrated
    scene = next((part.demonstrated.scene for part in parts if part.demonstrated.scene), None)
    straight = _straight(first.base_frame, parts)
    return Recording(
        demonstration_id=first.demonstration_id,
        task=first.task,
        user=first.user,
        cell=first.cell,
        base_frame=first.base_frame,
        end_effector_frame=first.end_effector_frame,
        objects=first.objects,
        outcome=last.outcome,
        tracks={child: _track(seen) for child, seen in sorted(straight.sightings.items()) if seen},
        gripper=tuple(sorted(straight.gripper, key=lambda sample: sample.stamp_ns)),
        presses=tuple(sorted(dict.fromkeys(straight.presses), key=lambda press: press.stamp_ns)),
        sha256=sha256_of(files),
        start_ns=first.start_ns,
        messages_lost=_joined_losses([part.demonstrated.messages_lost for part in parts]),
        scene=None if scene is None else _scene(files[0], scene),
        parents=frozenset().union(*(part.parents for part in parts)),
        gaps=tuple(dict.fromkeys(gap for part in parts for gap in part.demonstrated.gaps)),
        notes=(*straight.notes, *dict.fromkeys(note for part in parts for note in part.oddities.sentences)),
    )


def _scene(file: Path, text: str) -> Scene:
    try:
        return parse_scene(text)
    except ValueError as error:
        raise NotARecordingError(file, str(error)) from error


def _joined_losses(parts: Sequence[Mapping[str, int | None] | None]) -> dict[str, int | None] | None:
    """Losses add up over the parts; what is unknown in one is unknown in all."""
    counted = [part for part in parts if part is not None]
    total: dict[str, int | None] = {}
    for part in counted:
        for topic, count in part.items():
            before = total.get(topic, 0)
            total[topic] = None if count is None or before is None else before + count
    return total if counted else None


_Parsed = TypeVar("_Parsed")


class _Part:
    """One file, decoded. What cannot be is left out and noted, as long as its topic holds anything else."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.gripper: list[Arrived[GripperSample]] = []
        self.presses: list[Arrived[ActionPress]] = []
        self.sightings: dict[tuple[str, str], list[Arrived[Sighting]]] = defaultdict(list)
        self.oddities = Notices()
        self.demonstrated = read_header(file)
        decoders = {POSES: self._poses, GRIPPER: self._gripper, ACTION: self._action}
        for channel, message in messages(file, frozenset(decoders)):
            decoders[channel.topic](channel, message)
        self.parents = frozenset(parent for parent, _ in self.sightings)
        if self.oddities.sentences and not (self.sightings and self.gripper):
            self._refuse_what_is_nothing_but_odd()

    def _refuse_what_is_nothing_but_odd(self) -> None:
        for topic, found in ((POSES, self.sightings), (GRIPPER, self.gripper)):
            odd = [sentence for sentence in self.oddities.sentences if sentence.startswith(f"a message on {topic} ")]
            if odd and not found:
                raise NotARecordingError(self.file, odd[0])

    def _poses(self, channel: Channel, message: Message) -> None:
        if channel.message_encoding != "protobuf":
            raise NotARecordingError(self.file, f"{POSES} is encoded as {channel.message_encoding!r}, not as protobuf")
        for transform in self._parsed(channel, wire.parse_transforms, message.data) or ():
            seen = self._parsed(channel, wire.parse_sighting, transform)
            if seen:
                self.sightings[seen.parent, seen.child].append(Arrived(message.log_time, seen.stamp_ns, seen))

    def _gripper(self, channel: Channel, message: Message) -> None:
        sample = self._parsed(channel, wire.parse_gripper, message.data)
        if sample:
            self.gripper.append(Arrived(message.log_time, sample.stamp_ns, sample))

    def _action(self, channel: Channel, message: Message) -> None:
        try:
            press = wire.parse_action(message.data)
        except PayloadError as error:
            raise NotARecordingError(self.file, f"a message on {channel.topic} {error}") from error
        self.presses.append(Arrived(message.log_time, press.stamp_ns, press))

    def _parsed(self, channel: Channel, parse: Callable[[Any], _Parsed], what: Any) -> _Parsed | None:
        try:
            return parse(what)
        except PayloadError as error:
            self.oddities.add(f"a message on {channel.topic} {error}")
            return None


def _straight(base_frame: str, parts: Sequence[_Part]) -> Straight:
    """What all parts hold, on one timeline."""
    joined: dict[str, list[Arrived[Sighting]]] = defaultdict(list)
    for part in parts:
        for (parent, child), sightings in part.sightings.items():
            if parent == base_frame:
                joined[child] += sightings
    gripper = [sample for part in parts for sample in part.gripper]
    return straighten(joined, gripper, [press for part in parts for press in part.presses])


def _track(sightings: Sequence[Sighting]) -> Track:
    stamps = np.array([seen.stamp_ns for seen in sightings], dtype=np.int64)
    numbers = np.array([(*seen.position, *seen.quaternion_xyzw) for seen in sightings], dtype=np.float64)
    order = np.argsort(stamps, kind="stable")
    return Track(stamps[order], numbers[order, :3], numbers[order, 3:])


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
