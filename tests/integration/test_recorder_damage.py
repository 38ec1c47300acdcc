"""Damage: no byte is believed against its checksum; what is whole around a damaged place is saved, the rest said."""

from __future__ import annotations

import json
import struct
import tracemalloc
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Message, Metadata
from mcap.writer import CompressionType, Writer
from support_recordings import object_in_box

from pipelines.cli import main
from recorder.errors import NotARecordingError, RecorderError
from recorder.recording import DEMONSTRATION, Demonstrated, RecordingWriter, messages, read_recording, records
from recorder.recording.chunks import Batch
from recorder.recovery import recover


def written(
    path: Path, chunk_size: int = 4096, use_chunking: bool = True, compression: CompressionType = CompressionType.ZSTD
) -> Path:
    """A recording as another writer writes it: with an attachment, a profile, more metadata, and every checksum."""
    take = object_in_box(1)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_size, compression=compression, use_chunking=use_chunking,
                        enable_data_crcs=True)  # fmt: skip
        writer.start(profile="shop", library="somebody's writer")
        channels: dict[str, int] = {}
        for stamp_ns, topic, payload in take.messages:
            encoding = "protobuf" if topic == "/poses" else "json"
            channels.setdefault(topic, 0)
            channels[topic] = channels[topic] or writer.register_channel(topic, encoding, 0)
            writer.add_message(channels[topic], stamp_ns, payload, stamp_ns)
        writer.add_attachment(1, 2, "calibration.yaml", "text/yaml", b"a: 1")
        writer.add_metadata("shop", {"line": "3"})
        writer.add_metadata(DEMONSTRATION, take.metadata)
        writer.finish()
    return path


def chunks(file: Path) -> list[records.Record]:
    return [record for record in records.walk(file) if record.opcode == Opcode.CHUNK]


def flip(file: Path, offset: int) -> None:
    content = bytearray(file.read_bytes())
    content[offset] ^= 0x55
    file.write_bytes(content)


def counted(file: Path) -> int:
    return sum(1 for _ in messages(file))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return written(tmp_path / "one.mcap")


def test_every_byte_of_a_file_that_is_changed_is_noticed(tmp_path: Path) -> None:
    """In the data section and in the summary; only what stands in checksums themselves may read as `not given`."""
    file = written(tmp_path / "small.mcap", chunk_size=1 << 20)
    content, unnoticed = file.read_bytes(), []
    for offset in range(0, len(content), 37):
        file.write_bytes(content[:offset] + bytes((content[offset] ^ 0x55,)) + content[offset + 1 :])
        try:
            read_recording([file])
        except RecorderError:
            continue
        unnoticed.append(offset)
    assert unnoticed == []


def test_our_own_writer_sums_its_data_section(tmp_path: Path) -> None:
    shown = Demonstrated("d1", "task", "ann", "cell1", "base", "tool0", ("A",), "success")
    with RecordingWriter(tmp_path / "ours.mcap", shown) as writer:
        writer.write("/camera", b"picture", 1)
        writer.finish()
    flip(tmp_path / "ours.mcap", 30)
    with pytest.raises(NotARecordingError, match="checksum of its data section"):
        counted(tmp_path / "ours.mcap")


def test_what_lies_around_a_damaged_chunk_is_saved_and_what_is_gone_is_said(file: Path, tmp_path: Path) -> None:
    whole, damaged = counted(file), chunks(file)[2]
    inside = sum(isinstance(found, Message) for found in records.unpack(damaged))
    flip(file, damaged.end - 10)
    done = recover(file, tmp_path / "saved.mcap")
    assert counted(tmp_path / "saved.mcap") == whole - inside
    (sentence,) = done.gone
    assert f"the chunk at byte {damaged.offset} is damaged" in sentence
    assert " s from " in sentence
    assert json.loads(last_metadata(tmp_path / "saved.mcap")["gone"]) == [sentence]


def test_behind_a_record_whose_length_is_wrong_the_next_chunk_is_found(file: Path, tmp_path: Path) -> None:
    whole, damaged = counted(file), chunks(file)[2]
    content = bytearray(file.read_bytes())
    content[damaged.offset + 1 : damaged.offset + 9] = struct.pack("<Q", 2**63)
    file.write_bytes(content)
    done = recover(file, tmp_path / "saved.mcap")
    assert whole > counted(tmp_path / "saved.mcap") > whole - 200
    assert any("are damaged and left out" in sentence for sentence in done.gone)


def test_channels_that_only_a_damaged_chunk_told_are_had_from_the_summary(file: Path, tmp_path: Path) -> None:
    whole, first = counted(file), chunks(file)[0]
    inside = sum(isinstance(found, Message) for found in records.unpack(first))
    flip(file, first.end - 10)
    recover(file, tmp_path / "saved.mcap")
    assert counted(tmp_path / "saved.mcap") == whole - inside


def test_recovery_keeps_attachments_metadata_profile_and_library(file: Path, tmp_path: Path) -> None:
    flip(file, chunks(file)[1].end - 10)
    recover(file, tmp_path / "saved.mcap")
    with (tmp_path / "saved.mcap").open("rb") as stream:
        reader = make_reader(stream)
        header, (attachment,) = reader.get_header(), list(reader.iter_attachments())
        assert (header.profile, header.library) == ("shop", "somebody's writer")
        assert (attachment.name, attachment.data, attachment.log_time) == ("calibration.yaml", b"a: 1", 2)
        assert {"line": "3"} in [found.metadata for found in reader.iter_metadata()]


def test_what_had_no_chunks_gets_some_of_a_sensible_size(tmp_path: Path) -> None:
    file = written(tmp_path / "flat.mcap", use_chunking=False)
    whole = counted(file)
    file.write_bytes(file.read_bytes()[:-40])
    recover(file, tmp_path / "saved.mcap")
    assert counted(tmp_path / "saved.mcap") == whole
    assert 1 <= len(chunks(tmp_path / "saved.mcap")) < 10


def test_a_whole_file_has_nothing_to_recover(file: Path, tmp_path: Path) -> None:
    with pytest.raises(RecorderError, match="is whole"):
        recover(file, tmp_path / "saved.mcap")


@pytest.mark.parametrize("behind", [b"\0" * 100, b"more"])
def test_bytes_behind_the_end_are_said_and_what_comes_before_is_saved(
    file: Path, tmp_path: Path, behind: bytes
) -> None:
    whole = counted(file)
    file.write_bytes(file.read_bytes() + behind)
    with pytest.raises(NotARecordingError, match=f"comes {len(behind)} bytes more"):
        read_recording([file])
    assert "behind its end" in recover(file, tmp_path / "saved.mcap").gone[0]
    assert counted(tmp_path / "saved.mcap") == whole


def test_two_files_joined_are_said_to_be_two(file: Path, tmp_path: Path) -> None:
    whole = counted(file)
    file.write_bytes(file.read_bytes() * 2)
    with pytest.raises(NotARecordingError, match="comes another MCAP file"):
        read_recording([file])
    recover(file, tmp_path / "saved.mcap")
    assert counted(tmp_path / "saved.mcap") == whole


def padded(content: bytes, kinds: set[int]) -> Iterator[bytes]:
    """Records as a newer writer might write them: with fields behind those that are known."""
    offset = 0
    while offset < len(content):
        opcode, length = struct.unpack_from("<BQ", content, offset)
        body, offset = content[offset + 9 : offset + 9 + length], offset + 9 + length
        more = b"new field" if opcode in kinds else b""
        yield struct.pack("<BQ", opcode, len(body) + len(more)) + body + more


def test_fields_of_a_newer_writer_are_skipped(tmp_path: Path) -> None:
    file = written(tmp_path / "plain.mcap", compression=CompressionType.NONE)
    whole, rebuilt = counted(file), BytesIO()
    rebuilt.write(records.MAGIC)
    for record in records.walk(file):
        body = record.content
        if record.opcode == Opcode.CHUNK:
            chunk = records.parse(record)
            assert isinstance(chunk, Chunk)
            inside = b"".join(padded(chunk.data, {Opcode.CHANNEL, Opcode.SCHEMA}))
            told = Chunk("", inside, chunk.message_end_time, chunk.message_start_time, 0, len(inside))
            body = records.packed(told)[9:] + b"newer"
        if record.opcode in (Opcode.METADATA, Opcode.HEADER):
            body += b"newer"
        if record.opcode == Opcode.DATA_END:
            rebuilt.write(struct.pack("<BQI", Opcode.DATA_END, 4, 0))
            rebuilt.write(struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + records.MAGIC)
            break
        rebuilt.write(struct.pack("<BQ", record.opcode, len(body)) + body)
    file.write_bytes(rebuilt.getvalue())
    assert counted(file) == whole
    assert read_recording([file]).presses


def last_metadata(file: Path) -> dict[str, str]:
    parsed = (records.parse(record) for record in records.walk(file))
    *_, last = (found for found in parsed if isinstance(found, Metadata) and found.name == DEMONSTRATION)
    return last.metadata


def test_a_field_longer_than_its_record_is_damage_however_long(tmp_path: Path) -> None:
    file = tmp_path / "long.mcap"
    for length in (2**63, 2**63 - 1, 2**62, 2**32, 100):
        body = struct.pack("<QQQI", 0, 0, 0, 0) + struct.pack("<I", 0) + struct.pack("<Q", length)
        header = records.packed(Channel(1, "/t", "json", {}, 0))
        file.write_bytes(records.MAGIC + header + struct.pack("<BQ", Opcode.CHUNK, len(body)) + body)
        with pytest.raises(NotARecordingError, match="is longer than its record"):
            counted(file)


def test_the_command_says_what_is_gone(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flip(file, chunks(file)[1].end - 10)
    assert main(["recover", str(file), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert len(document["gone"]) == 1
    assert counted(Path(document["file"])) == sum(document["messages"].values())


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_chunk_that_is_too_large_to_be_held_reads_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: CompressionType
) -> None:
    file = written(tmp_path / "one.mcap", chunk_size=1 << 30, compression=compression)
    held = [(channel.topic, message) for channel, message in messages(file)]
    monkeypatch.setattr(records, "LARGE", 1000)
    assert [(channel.topic, message) for channel, message in messages(file)] == held


@pytest.mark.parametrize("compression", list(CompressionType))
def test_nothing_of_a_large_chunk_is_believed_before_all_of_it_was_verified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: CompressionType
) -> None:
    monkeypatch.setattr(records, "LARGE", 1000)
    file = written(tmp_path / "one.mcap", chunk_size=1 << 30, compression=compression)
    (chunk,) = chunks(file)
    flip(file, chunk.end - 10)
    with pytest.raises(NotARecordingError, match=f"damaged at byte {chunk.offset}"):
        next(messages(file))


def test_memory_of_reading_grows_neither_with_a_chunk_nor_with_an_attachment(tmp_path: Path) -> None:
    large = 4 * records.LARGE
    with RecordingWriter(tmp_path / "large.mcap", Demonstrated("d", "t", "u", "c", "base", "tool0", ("A",))) as writer:
        batch = Batch()
        for number in range(64):
            batch.add(1, number, number, number, bytes(large // 64))
        writer.add_channel(1, "/camera", "zenoh/bytes")
        writer.write_batch(batch)
        writer.adopt_attachment(Attachment(0, 0, "video", "video/mp4", bytes(large)))
        writer.finish()
    del batch
    tracemalloc.start()
    try:
        assert counted(tmp_path / "large.mcap") == 64
        assert tracemalloc.get_traced_memory()[1] < records.LARGE
    finally:
        tracemalloc.stop()
