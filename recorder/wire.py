"""The keys, encodings and codecs of CONTRACT, section 1, written down once: for the recorder, the cell and their tests.

    key below treewright/<cell>/   topic in the file   payload
    poses                          /poses              protobuf foxglove.FrameTransforms
    gripper                        /gripper            JSON {"stamp_ns", "state", "width_m"}
    action                         /action             JSON {"stamp_ns", "type", "object"?, …}
    signals/<name>                 /signals/<name>     JSON {"stamp_ns", "value"}

Every codec comes as a pair, `x_message` and `parse_x`. What cannot be parsed raises PayloadError with a sentence that
tells what the payload is instead, without its topic's name.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple, cast

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.message import DecodeError

from learner.model import ActionPress, GripperSample, Pose
from recorder.errors import PayloadError

NS: Final = 1_000_000_000
ROOT: Final = "treewright"
POSES, GRIPPER, ACTION = "/poses", "/gripper", "/action"
SIGNALS: Final = "/signals/"
"""Begins the topic of every signal."""
ATTACHMENT: Final = "/@attachment"
"""Behind a topic: the attachments of its samples, each just before its sample and with the same times. No key ends so,
since chunks with `@` are not recorded."""
ESSENTIAL: Final = (POSES, GRIPPER, ACTION)
"""The topics that learning needs."""
NOT_RECORDED: Final = ("recorder", "skills")
"""First chunks of the keys that are never recorded."""

ADVANCED: Final = "/@adv/pub/"
"""Behind the key of a publisher of zenoh.ext stands so what is said of it: <key>/@adv/pub/<session>/<number>/…"""

JSON_ENCODING: Final = "application/json"
POSES_ENCODING: Final = "application/protobuf;foxglove.FrameTransforms"
GRIPPER_ENCODING: Final = "application/json;treewright.GripperState"
ACTION_ENCODING: Final = "application/json;treewright.DemonstratedAction"
SIGNAL_ENCODING: Final = "application/json;treewright.Signal"
ENCODINGS: Final = {POSES: POSES_ENCODING, GRIPPER: GRIPPER_ENCODING, ACTION: ACTION_ENCODING}

_FIRST, _SECOND = 0x0A, 0x12
"""How protobuf marks the first and the second field of a message, if they hold bytes."""
_LATEST_NS: Final = 2**63


# --- keys -----------------------------------------------------------------------------------------------------------


def prefix_of(cell: str) -> str:
    """What every key of a cell begins with, the slash at its end included."""
    return f"{ROOT}/{cell}/"


def key_of(cell: str, topic: str) -> str:
    """The key of a topic of the file, with or without its leading slash."""
    return prefix_of(cell) + topic.lstrip("/")


def json_message(document: Mapping[str, Any]) -> bytes:
    """A JSON object as it is sent: requests, replies, events."""
    return json.dumps(document, sort_keys=True).encode()


# --- poses ----------------------------------------------------------------------------------------------------------


class Sighting(NamedTuple):
    """Where a child stood in its parent: position [m], unit quaternion xyzw, stamp [ns]."""

    parent: str
    child: str
    stamp_ns: int
    position: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]


def pose_message(stamp_ns: int, base_frame: str, poses: Mapping[str, Pose]) -> bytes:
    """A message for /poses: the poses of children in the base frame, all at one stamp [ns]."""
    message = FrameTransforms()
    for child, pose in poses.items():
        transform = message.transforms.add()
        transform.timestamp.seconds, transform.timestamp.nanos = divmod(stamp_ns, NS)
        transform.parent_frame_id, transform.child_frame_id = base_frame, child
        t, r = transform.translation, transform.rotation
        t.x, t.y, t.z = pose.position
        r.x, r.y, r.z, r.w = pose.quaternion_xyzw
    return message.SerializeToString()


def is_single(payload: bytes) -> bool:
    """Whether a payload of /poses looks like one FrameTransform without its list. Costs nothing: two bytes are read.

    A list holds its first field again and again, a FrameTransform goes on with the second (its parent).
    """
    if payload[:1] == bytes((_SECOND,)):
        return True
    if len(payload) < 2 or payload[0] != _FIRST or payload[1] >= 0x80:
        return False
    return payload[2 + payload[1] : 3 + payload[1]] == bytes((_SECOND,))


def listed(payload: bytes) -> bytes:
    """A single FrameTransform as the FrameTransforms that holds nothing else; anything else as it is."""
    if not is_single(payload):
        return payload
    try:
        return FrameTransforms(transforms=[FrameTransform.FromString(payload)]).SerializeToString()
    except DecodeError:
        return payload


def parse_transforms(payload: bytes) -> Sequence[FrameTransform]:
    """The transforms in a message of /poses, in its order; a single FrameTransform is a list of one.

    Raises PayloadError.
    """
    try:
        return cast(Sequence[FrameTransform], FrameTransforms.FromString(listed(payload)).transforms)
    except DecodeError:
        what = "JSON" if _is_json(payload) else f"{payload[:20]!r}"
        raise PayloadError(f"is {what}, no foxglove.FrameTransforms in protobuf") from None


def parse_sighting(transform: FrameTransform) -> Sighting:
    """Where a transform says that its child stood. Raises PayloadError for one that says nothing."""
    t, r, stamp = transform.translation, transform.rotation, transform.timestamp
    stamp_ns = stamp.seconds * NS + stamp.nanos
    norm = math.sqrt(r.x * r.x + r.y * r.y + r.z * r.z + r.w * r.w)
    child = transform.child_frame_id
    if not all(map(math.isfinite, (t.x, t.y, t.z, norm))):
        raise PayloadError(f"gives {child!r} a pose that is not finite")
    if norm < 1e-6:
        raise PayloadError(f"gives {child!r} a quaternion of zeros; one that does not turn is (0, 0, 0, 1)")
    if stamp_ns == 0:
        raise PayloadError(f"gives {child!r} no timestamp")
    if not 0 < stamp_ns < _LATEST_NS:
        raise PayloadError(f"gives {child!r} the timestamp {stamp_ns} ns, which no clock shows")
    turned = (r.x / norm, r.y / norm, r.z / norm, r.w / norm)
    return Sighting(transform.parent_frame_id, child, stamp_ns, (t.x, t.y, t.z), turned)


# --- gripper, actions, signals --------------------------------------------------------------------------------------


def gripper_message(stamp_ns: int, state: str, width_m: float | None = None) -> bytes:
    """A message for /gripper; stamp in [ns], width in [m]."""
    return _packed({"stamp_ns": stamp_ns, "state": state, "width_m": width_m})


def parse_gripper(payload: bytes) -> GripperSample:
    """Raises PayloadError."""
    content = _stamped(payload)
    state, width = content.get("state"), content.get("width_m")
    if state not in ("open", "closed"):
        raise PayloadError(f"has the state {state!r:.80}, not open or closed")
    told = isinstance(width, int | float) and not isinstance(width, bool) and abs(width) < 1e9
    return GripperSample(content["stamp_ns"], state, float(cast(float, width)) if told else None)


def action_message(stamp_ns: int, kind: str, **more: Any) -> bytes:
    """A message for /action: `more` are its further fields, such as `object`; those that are None are left out."""
    fields = {name: value for name, value in more.items() if value is not None}
    return _packed({"stamp_ns": stamp_ns, "type": kind, **fields})


def parse_action(payload: bytes) -> ActionPress:
    """Raises PayloadError. Whether its type is one of the contract's is for those who judge it."""
    content = _stamped(payload)
    kind, name, signal, value = (content.get(field) for field in ("type", "object", "signal", "value"))
    if not isinstance(kind, str) or not (name is None or isinstance(name, str)):
        raise PayloadError(f"needs a type and may name an object: {content!s:.80}")
    if not (signal is None or isinstance(signal, str)) or not isinstance(value, bool | int | float | str | None):
        raise PayloadError(f"may name a signal and its value, a truth, number or text: {content!s:.80}")
    if isinstance(value, float) and not math.isfinite(value):
        raise PayloadError(f"sets a signal to {value}, which is no number: {content!s:.80}")
    return ActionPress(content["stamp_ns"], kind, name, signal, value)


def signal_message(stamp_ns: int, value: bool | float | str) -> bytes:
    """A message for a signal."""
    return _packed({"stamp_ns": stamp_ns, "value": value})


def parse_signal(payload: bytes) -> tuple[int, bool | int | float | str]:
    """Stamp [ns] and value. Raises PayloadError."""
    content = _stamped(payload)
    value = content.get("value")
    if not isinstance(value, bool | int | float | str):
        raise PayloadError(f"has the value {value!r:.80}, which is no truth, number or text")
    return content["stamp_ns"], value


def _packed(document: Mapping[str, Any]) -> bytes:
    return json.dumps(document).encode()


def _stamped(payload: bytes) -> dict[str, Any]:
    """The JSON object of a payload, with its stamp in whole nanoseconds."""
    try:
        content = json.loads(payload)
        if b"\\u" in payload:
            # Half of a surrogate pair can be written in JSON, and can be told to nobody.
            json.dumps(content, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:
        raise PayloadError(f"is not JSON: {error!s:.80}") from error
    stamp = content.get("stamp_ns") if isinstance(content, dict) else None
    if type(stamp) is not int or not 0 <= stamp < _LATEST_NS:
        raise PayloadError(f"has no stamp_ns in whole nanoseconds: {content!s:.80}")
    return cast(dict[str, Any], content)


def _is_json(payload: bytes) -> bool:
    return payload.lstrip()[:1] in (b"{", b"[")
