"""The format of a recording: what is written is read, and what is none is refused with a sentence."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from learner.model import ActionPress, GripperSample, Pose
from recorder.errors import NotARecordingError, PartMissingError, RecorderError, TornRecordingError
from recorder.recording import Demonstrated, RecordingWriter, messages, read_header, read_recording, sha256_of
from recorder.wire import ACTION, GRIPPER, POSES, pose_message

DEMONSTRATED = Demonstrated(
    demonstration_id="stacking-1",
    task="stacking",
    user="u1",
    cell="cell1",
    base_frame="base",
    end_effector_frame="tool0",
    objects=("A", "B"),
    outcome="success",
    start_ns=1_000,
    messages_lost={"/poses": 0, "/image": None},
    scene=json.dumps({"objects": {"A": {"size_m": [0.05, 0.05, 0.05], "symmetry": "cube"}}}),
    more={"shift": "night"},
)
A = Pose((0.1, 0.2, 0.3), (0.0, 0.0, 0.6, 0.8))


def write(file: Path, demonstrated: Demonstrated = DEMONSTRATED, stamps_ns: range = range(1_000, 4_000, 1_000)) -> Path:
    with RecordingWriter(file, demonstrated) as writer:
        for stamp_ns in stamps_ns:
            writer.write(POSES, pose_message(stamp_ns, "base", {"A": A, "tool0": Pose((0, 0, 1))}), stamp_ns)
        writer.write(GRIPPER, b'{"stamp_ns": 1500, "state": "open", "width_m": 0.08}', 1_500)
        writer.write(ACTION, b'{"stamp_ns": 2000, "type": "pick", "object": "A"}', 2_000)
        writer.finish()
    return file


def test_what_is_written_is_read(tmp_path: Path) -> None:
    recording = read_recording([write(tmp_path / "one.mcap")])
    assert recording.tracks["A"].stamps_ns.tolist() == [1_000, 2_000, 3_000]
    assert recording.tracks["A"].positions[0] == pytest.approx(A.position)
    assert recording.tracks["A"].quaternions_xyzw[0] == pytest.approx(A.quaternion_xyzw)
    assert recording.gripper == (GripperSample(1_500, "open", 0.08),)
    assert recording.presses == (ActionPress(2_000, "pick", "A"),)
    assert recording.parents == {"base"}
    assert recording.messages_lost == {"/poses": 0, "/image": None}
    assert recording.scene is not None
    assert recording.scene.objects["A"].symmetry == "cube"
    assert recording.sha256 == sha256_of([tmp_path / "one.mcap"])


def test_the_record_of_what_was_demonstrated_survives_with_every_further_entry(tmp_path: Path) -> None:
    assert read_header(write(tmp_path / "one.mcap")) == DEMONSTRATED


def test_plain_mcap_and_the_protobuf_decoder_read_it(tmp_path: Path) -> None:
    with write(tmp_path / "one.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 5
        decoded = [message.transforms for *_, message in reader.iter_decoded_messages(topics=[POSES])]
        assert {transform.child_frame_id for transform in decoded[0]} == {"A", "tool0"}
        assert [message.data for _, _, message in reader.iter_messages(topics=[ACTION], starting_at=2_000)]
        assert {schema.name for schema in summary.schemas.values()} == {
            "foxglove.FrameTransforms",
            "treewright.GripperState",
            "treewright.DemonstratedAction",
        }


def test_message_indexes_point_at_the_messages(tmp_path: Path) -> None:
    """Readers that seek, as Foxglove's, find messages by these offsets alone."""
    from io import BytesIO

    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Chunk, MessageIndex
    from mcap.stream_reader import get_chunk_data_stream

    from recorder.recording.chunks import MESSAGE
    from recorder.recording.records import walk

    file = write(tmp_path / "one.mcap")
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        whole = file.read_bytes()
    records = {record.offset: record for record in walk(file)}
    for index in summary.chunk_indexes:
        chunk = Chunk.read(ReadDataStream(BytesIO(records[index.chunk_start_offset].content)))
        data = get_chunk_data_stream(chunk)[0]._stream.read()  # type: ignore[attr-defined]
        for channel, offset in index.message_index_offsets.items():
            assert whole[offset] == Opcode.MESSAGE_INDEX
            entries = MessageIndex.read(ReadDataStream(BytesIO(records[offset].content)))
            assert entries.channel_id == channel
            for log_ns, place in entries.records:
                opcode, _, in_channel, _, in_log_ns, _ = MESSAGE.unpack_from(data, place)
                assert (opcode, in_channel, in_log_ns) == (Opcode.MESSAGE, channel, log_ns)


def test_the_last_record_wins(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "one.mcap", DEMONSTRATED) as writer:
        writer.finish(replace(DEMONSTRATED, outcome="failure"))
    assert read_header(tmp_path / "one.mcap").outcome == "failure"


def test_an_unfinished_file_says_that_its_outcome_is_unknown(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "one.mcap", DEMONSTRATED) as writer:
        unfinished = writer.unfinished
    assert not (tmp_path / "one.mcap").exists()
    assert b"success" not in unfinished.read_bytes()
    with pytest.raises(TornRecordingError, match=r"torn.*treewright recover"):
        read_header(unfinished)


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    before = write(tmp_path / "one.mcap").read_bytes()
    with pytest.raises(RecorderError, match="never overwritten"):
        RecordingWriter(tmp_path / "one.mcap", DEMONSTRATED)
    assert (tmp_path / "one.mcap").read_bytes() == before


def test_a_file_that_reads_back_otherwise_is_not_called_finished(tmp_path: Path) -> None:
    """A disk that changes a byte after it was written: the file does not get its name."""
    with RecordingWriter(tmp_path / "one.mcap", DEMONSTRATED) as writer:
        writer.write(ACTION, b'{"stamp_ns": 2000, "type": "pick"}', 2_000)
        writer.close_chunk()
        with writer.unfinished.open("r+b") as stream:
            stream.seek(20)
            stream.write(b"\xff")
        with pytest.raises(RecorderError, match="reads back otherwise"):
            writer.finish()
    assert not (tmp_path / "one.mcap").exists()


def test_poses_that_are_none_are_no_sightings(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "one.mcap", DEMONSTRATED) as writer:
        from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

        good = FrameTransforms.FromString(pose_message(1_000, "base", {"A": A}))
        for breakage in ("translation", "rotation", "stamp", "parent"):
            broken = FrameTransforms()
            broken.CopyFrom(good)
            transform = broken.transforms[0]
            if breakage == "translation":
                transform.translation.x = float("nan")
            elif breakage == "rotation":
                transform.ClearField("rotation")
            elif breakage == "stamp":
                transform.ClearField("timestamp")
            else:
                transform.parent_frame_id = "camera"
            writer.write(POSES, broken.SerializeToString(), 500)
        writer.write(POSES, good.SerializeToString(), 1_000)
        writer.finish()
    recording = read_recording([tmp_path / "one.mcap"])
    assert recording.tracks["A"].stamps_ns.tolist() == [1_000]
    assert recording.parents == {"base", "camera"}


def test_equal_presses_are_one(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "one.mcap", DEMONSTRATED) as writer:
        for _ in range(2):
            writer.write(ACTION, b'{"stamp_ns": 2000, "type": "pick"}', 2_000)
        writer.finish()
    assert read_recording([tmp_path / "one.mcap"]).presses == (ActionPress(2_000, "pick", None),)


def test_parts_are_joined_in_their_order(tmp_path: Path) -> None:
    first = write(tmp_path / "a.mcap", replace(DEMONSTRATED, part=1, continued=True, outcome="unknown"))
    second = write(tmp_path / "b.mcap", replace(DEMONSTRATED, part=2), range(5_000, 7_000, 1_000))
    recording = read_recording([second, first])
    assert recording.tracks["A"].stamps_ns.tolist() == [1_000, 2_000, 3_000, 5_000, 6_000]
    assert recording.outcome == "success"
    assert recording.sha256 == sha256_of([first, second])
    assert recording.messages_lost == {"/poses": 0, "/image": None}


def test_a_split_demonstration_counts_once_all_parts_are_there(tmp_path: Path) -> None:
    first = write(tmp_path / "a.mcap", replace(DEMONSTRATED, part=1, continued=True))
    third = write(tmp_path / "c.mcap", replace(DEMONSTRATED, part=3))
    with pytest.raises(PartMissingError, match="lacks its part 2"):
        read_recording([first])
    with pytest.raises(PartMissingError, match="lacks its part 2"):
        read_recording([first, third])


@pytest.mark.parametrize(
    ("metadata", "sentence"),
    [
        ({"contract": "2"}, "version '2' of the contract"),
        ({"objects": "A, B"}, "`objects` of its record is not JSON"),
        ({"objects": '{"A": 1}'}, "not a JSON array of names"),
        ({"part": "one"}, "`part` of its record is not a whole number"),
        ({"messages_lost": "[1]"}, "does not count by topic"),
        ({"scene": "[]"}, "scene is not as the contract"),
        ({"scene": '{"objects": {"A": {"size_m": [0, 1, 1]}}}'}, "not three positive lengths"),
    ],
)
def test_a_record_that_breaks_the_contract_is_refused(tmp_path: Path, metadata: dict[str, str], sentence: str) -> None:
    write_raw(tmp_path / "one.mcap", {**DEMONSTRATED.to_metadata(), **metadata})
    with pytest.raises(NotARecordingError, match=sentence):
        read_recording([tmp_path / "one.mcap"])


@pytest.mark.parametrize("name", ["contract", "demonstration_id", "objects", "outcome", "base_frame"])
def test_a_record_that_lacks_an_entry_is_refused(tmp_path: Path, name: str) -> None:
    metadata = DEMONSTRATED.to_metadata()
    del metadata[name]
    write_raw(tmp_path / "one.mcap", metadata)
    with pytest.raises(NotARecordingError, match=f"lacks {name}"):
        read_header(tmp_path / "one.mcap")


def write_raw(file: Path, metadata: dict[str, str] | None) -> None:
    """A file by the MCAP project's own writer."""
    from mcap.writer import Writer

    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        if metadata is not None:
            writer.add_metadata("treewright.demonstration", metadata)
        writer.finish()


def test_a_file_without_a_record_is_refused(tmp_path: Path) -> None:
    write_raw(tmp_path / "one.mcap", None)
    with pytest.raises(NotARecordingError, match=r"no metadata record treewright\.demonstration"):
        read_header(tmp_path / "one.mcap")


@pytest.mark.parametrize(
    ("topic", "payload", "sentence"),
    [
        (ACTION, b"pick", "a message on /action is not JSON"),
        (ACTION, b'{"type": "pick"}', "no stamp_ns"),
        (ACTION, b'{"stamp_ns": 1.5, "type": "pick"}', "no stamp_ns"),
        (ACTION, b'{"stamp_ns": 1, "type": 7}', "needs a type"),
        (GRIPPER, b'{"stamp_ns": 1, "state": "ajar"}', "not open or closed"),
        (POSES, b"\xff\xff\xff", "no foxglove.FrameTransforms"),
    ],
)
def test_a_message_that_is_none_is_refused(tmp_path: Path, topic: str, payload: bytes, sentence: str) -> None:
    with RecordingWriter(tmp_path / "one.mcap", DEMONSTRATED) as writer:
        writer.write(topic, payload, 1_000)
        writer.finish()
    with pytest.raises(NotARecordingError, match=sentence):
        read_recording([tmp_path / "one.mcap"])


def test_every_torn_end_is_told_from_damage(tmp_path: Path) -> None:
    whole = write(tmp_path / "one.mcap").read_bytes()
    torn = tmp_path / "torn.mcap"
    for length in [*range(0, len(whole), 37), len(whole) - 1]:
        torn.write_bytes(whole[:length])
        with pytest.raises(TornRecordingError):
            read_header(torn)
    torn.write_bytes(whole[: len(whole) // 2] + bytes(500))
    with pytest.raises((TornRecordingError, NotARecordingError)):
        read_header(torn)


def test_damage_in_a_chunk_is_found(tmp_path: Path) -> None:
    file = write(tmp_path / "one.mcap")
    data = bytearray(file.read_bytes())
    place = data.index(b"zstd") + 40
    data[place] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(NotARecordingError, match="damaged at byte"):
        list(messages(file))


def test_what_is_no_mcap_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "one.mcap").write_bytes(b"PK\x03\x04 and so on")
    with pytest.raises(NotARecordingError, match="does not begin as an MCAP file does"):
        read_recording([tmp_path / "one.mcap"])


def test_the_samples_of_another_writer_are_read() -> None:
    folder = Path("../shared/data/contract_samples")
    files = sorted(folder.glob("*.mcap"))
    if not files:
        pytest.skip(f"{folder} is not here")
    for file in files:
        recording = read_recording([file])
        assert recording.outcome == "success"
        assert set(recording.objects) < set(recording.tracks)
        assert len(recording.presses) >= 2
