"""The schemas of the contract's topics, and MCAP's words for what is in their messages."""

from __future__ import annotations

import json
from typing import Any, Final

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from mcap.records import Schema

from recorder.foxglove import SHOWN
from recorder.wire import ACTION, ENCODINGS, GRIPPER, POSES

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
_FIRST_SHOWN: Final = 4
"""The number of the first schema that is not the contract's."""
_MEDIA: Final = (("application/json", "json"), ("text/json", "json"), ("application/protobuf", "protobuf"))


def schema_of(topic: str) -> Schema | None:
    """The schema of a topic of the contract, or of what the recorder shows in Foxglove; other topics have none."""
    if topic == POSES:
        return Schema(
            id=1, name="foxglove.FrameTransforms", encoding="protobuf", data=_file_descriptor_set(FrameTransforms)
        )
    if topic in SHOWN:
        number, name = _FIRST_SHOWN + list(SHOWN).index(topic), SHOWN[topic].DESCRIPTOR.full_name
        return Schema(id=number, name=name, encoding="protobuf", data=_file_descriptor_set(SHOWN[topic]))
    known = {GRIPPER: (2, _GRIPPER_SCHEMA), ACTION: (3, _ACTION_SCHEMA)}
    if topic not in known:
        return None
    number, schema = known[topic]
    text = json.dumps(schema, sort_keys=True).encode()
    return Schema(id=number, name=str(schema["title"]), encoding="jsonschema", data=text)


def message_encoding(topic: str, zenoh_encoding: str) -> str:
    """MCAP's word for a payload. Without a schema readers can decode JSON alone, so the rest goes by its media type."""
    if topic in SHOWN:
        return "protobuf"
    if topic in ENCODINGS:
        return "protobuf" if topic == POSES else "json"
    media = zenoh_encoding.partition(";")[0]
    return dict(_MEDIA[:2]).get(media, media)


def _file_descriptor_set(message: type[Message]) -> bytes:
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

    file: Any = message.DESCRIPTOR.file  # its stub names another class with the same parts
    add(file)
    return found.SerializeToString()
