"""The codecs of the wire: what one side writes the other reads, and anything else is told for what it is."""

from __future__ import annotations

import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from hypothesis import given
from hypothesis import strategies as st

from learner.model import ActionPress, GripperSample, Pose
from recorder import wire
from recorder.errors import PayloadError

STAMP = 1_700_000_000_123_456_789


def transform(**fields: object) -> FrameTransform:
    whole = FrameTransform.FromString(FrameTransforms.FromString(POSE).transforms[0].SerializeToString())
    for name, value in fields.items():
        target = getattr(whole, name)
        if isinstance(value, dict):
            for part, number in value.items():
                setattr(target, part, number)
        else:
            setattr(whole, name, value)
    return whole


POSE = wire.pose_message(STAMP, "base", {"A": Pose((0.1, 0.2, 0.3))})


def test_what_is_written_is_read() -> None:
    (sighting,) = map(wire.parse_sighting, wire.parse_transforms(POSE))
    assert sighting == wire.Sighting("base", "A", STAMP, (0.1, 0.2, 0.3), (0.0, 0.0, 0.0, 1.0))
    assert wire.parse_gripper(wire.gripper_message(STAMP, "open", 0.08)) == GripperSample(STAMP, "open", 0.08)
    assert wire.parse_action(wire.action_message(STAMP, "pick", object="A")) == ActionPress(STAMP, "pick", "A")
    signal = wire.action_message(STAMP, "signal", signal="door", value=0.5)
    assert wire.parse_action(signal) == ActionPress(STAMP, "signal", None, "door", 0.5)
    assert wire.parse_signal(wire.signal_message(STAMP, "ready")) == (STAMP, "ready")


@given(st.integers(0, 2**62), st.text(max_size=200), st.text(max_size=200))
def test_a_single_transform_is_a_list_of_one(stamp_ns: int, parent: str, child: str) -> None:
    seconds, nanos = divmod(stamp_ns, wire.NS)
    single = FrameTransform(parent_frame_id=parent, child_frame_id=child)
    single.timestamp.seconds, single.timestamp.nanos = seconds, nanos
    single.rotation.w = 1.0
    many = FrameTransforms(transforms=[single, single]).SerializeToString()
    assert wire.listed(many) == many
    if parent:
        assert list(wire.parse_transforms(single.SerializeToString())) == [single]


@pytest.mark.parametrize(
    ("payload", "what"),
    [
        (b'{"transforms": []}', "is JSON"),
        (b'[{"parent_frame_id": "base"}]', "is JSON"),
        (b"\x00\x01\x02", "no foxglove.FrameTransforms in protobuf"),
        (b"\x12\xff", "no foxglove.FrameTransforms in protobuf"),
    ],
)
def test_poses_that_are_none_are_told_for_what_they_are(payload: bytes, what: str) -> None:
    with pytest.raises(PayloadError, match=what):
        wire.parse_transforms(payload)


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"rotation": {"w": 0.0}}, "'A' a quaternion of zeros"),
        ({"timestamp": {"seconds": 0, "nanos": 0}}, "'A' no timestamp"),
        ({"timestamp": {"seconds": -5}}, "which no clock shows"),
        ({"timestamp": {"seconds": 2**62}}, "which no clock shows"),
        ({"translation": {"x": float("nan")}}, "not finite"),
        ({"rotation": {"x": float("inf")}}, "not finite"),
    ],
)
def test_a_pose_that_says_nothing_is_told_for_what_it_is(fields: dict[str, dict[str, float]], what: str) -> None:
    with pytest.raises(PayloadError, match=what):
        wire.parse_sighting(transform(**fields))


@pytest.mark.parametrize("payload", [b"", b"open", b"null", b"[]", b"{}", b'{"stamp_ns": 1.5}', b"[" * 100_000,
                                     b'{"stamp_ns": true}', b'{"stamp_ns": -1}', b"\xff\xfe", b"9" * 5000])  # fmt: skip
@pytest.mark.parametrize("parse", [wire.parse_gripper, wire.parse_action, wire.parse_signal])
def test_any_other_payload_is_one_sentence(parse: object, payload: bytes) -> None:
    with pytest.raises(PayloadError, match=r"^(is not JSON|has no stamp_ns)"):
        parse(payload)  # type: ignore[operator]


@pytest.mark.parametrize("state", ["half", None, 1, ["open"]])
def test_a_gripper_is_open_or_closed(state: object) -> None:
    with pytest.raises(PayloadError, match="not open or closed"):
        wire.parse_gripper(wire._packed({"stamp_ns": STAMP, "state": state}))
