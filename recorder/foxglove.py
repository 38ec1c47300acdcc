"""What a recording carries for those who look at it in Foxglove: the scene as boxes, presses and alarms as log lines.

The recorder itself is their source, so they lie below `/recorder/`, where no key of a cell is recorded; a replay
leaves them out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from learner.model import Scene
from learner.model.pose import Vector

BOXES: Final = "/recorder/scene"
LINES: Final = "/recorder/log"
SHOWN: Final[Mapping[str, Any]] = {BOXES: SceneUpdate, LINES: Log}
"""The protobuf message of each topic."""
SHOWN_ENCODINGS: Final = {topic: f"application/protobuf;{each.DESCRIPTOR.full_name}" for topic, each in SHOWN.items()}
LEVELS: Final[Mapping[str, Any]] = {"accepted": Log.INFO, "doubtful": Log.WARNING, "contradicts": Log.ERROR}
"""How loud a press is, by its verdict."""
WORKSPACE: Final = "the workspace"
"""No name of an object holds a space."""
COLORS: Final = ((0.90, 0.62, 0.00), (0.34, 0.71, 0.91), (0.00, 0.62, 0.45), (0.94, 0.89, 0.26), (0.80, 0.47, 0.65))
"""Told apart by people who see few colours, too."""
WHITE: Final = Color(r=1.0, g=1.0, b=1.0, a=1.0)
SOLID: Final = 0.85
HOLLOW: Final = 0.30
WIDE_M: Final = 0.15
"""What is wider may hold something, into which one has to see."""
FAINT: Final = 0.10
LETTERS_M: Final = 0.03


def boxes_message(stamp_ns: int, base_frame: str, scene: Scene) -> bytes:
    """A box of its size and a name for each object, fixed to the object's frame, and the workspace in the base."""
    entities = [
        _entity(stamp_ns, name, name, _box(shape.size_m, n, max(shape.size_m[:2]) > WIDE_M), name)
        for n, (name, shape) in enumerate(sorted(scene.objects.items()))
    ]
    if scene.workspace_m is not None:
        (x0, x1), (y0, y1) = scene.workspace_m
        size, center = (x1 - x0, y1 - y0, 0.001), ((x0 + x1) / 2, (y0 + y1) / 2, 0.0)
        entities.append(_entity(stamp_ns, WORKSPACE, base_frame, _cube(size, center, (0.5, 0.5, 0.5), FAINT)))
    serialized: bytes = SceneUpdate(entities=entities).SerializeToString()
    return serialized


def press_message(stamp_ns: int, pressed: Mapping[str, Any]) -> bytes:
    """The line of a press, from what the recorder replies to it (CONTRACT, section 1)."""
    what = f"{pressed['type']} {pressed['object']}" if pressed.get("object") else str(pressed["type"])
    reason = f": {pressed['reason']}" if pressed.get("reason") else ""
    text = f"step {pressed['step']}, {what}: {pressed['verdict']}{reason}"
    return _line(stamp_ns, LEVELS[str(pressed["verdict"])], "press", text)


def alarm_message(stamp_ns: int, sentence: str) -> bytes:
    """The line of an alarm."""
    return _line(stamp_ns, Log.WARNING, "alarm", sentence)


def _line(stamp_ns: int, level: Any, name: str, text: str) -> bytes:
    log = Log(level=level, name=name, message=text)
    log.timestamp.FromNanoseconds(stamp_ns)
    serialized: bytes = log.SerializeToString()
    return serialized


def _entity(stamp_ns: int, name: str, frame: str, cube: CubePrimitive, label: str = "") -> SceneEntity:
    entity = SceneEntity(id=name, frame_id=frame, frame_locked=True, cubes=[cube])
    entity.timestamp.FromNanoseconds(stamp_ns)
    if label:
        above = _at((0.0, 0.0, cube.size.z / 2 + LETTERS_M))
        entity.texts.append(TextPrimitive(text=label, pose=above, billboard=True, font_size=LETTERS_M, color=WHITE))
        entity.metadata.append(KeyValuePair(key="object", value=label))
    return entity


def _box(size_m: Vector, number: int, wide: bool) -> CubePrimitive:
    return _cube(size_m, (0.0, 0.0, 0.0), COLORS[number % len(COLORS)], HOLLOW if wide else SOLID)


def _cube(size_m: Vector, center_m: Vector, color: Vector, alpha: float) -> CubePrimitive:
    return CubePrimitive(pose=_at(center_m), size=_vector(size_m), color=_color(color, alpha))


def _at(position_m: Vector) -> Pose:
    return Pose(position=_vector(position_m), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))


def _vector(values: Vector) -> Vector3:
    x, y, z = values
    return Vector3(x=x, y=y, z=z)


def _color(color: Vector, alpha: float) -> Color:
    red, green, blue = color
    return Color(r=red, g=green, b=blue, a=alpha)
