"""Bags as ROS 2 writes them, by the rosbags library: a simulated demonstration told as tf2 chains and a gripper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from learner.model import Pose, Recording

STORE = get_typestore(Stores.ROS2_JAZZY)
CAMERA = Pose((0.8, 0.1, 1.2), (0.9, 0.1, 0.2, 0.3))
"""Of the camera in the base: fixed."""
WRIST = Pose((0.0, 0.0, -0.1), (0.0, 0.0, 0.6, 0.8))
"""Of the flange in the tool's frame: where the moving link ends."""
NS = 1_000_000_000


def message(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def stamp(stamp_ns: int) -> Any:
    return message("builtin_interfaces/msg/Time", sec=stamp_ns // NS, nanosec=stamp_ns % NS)


def header(stamp_ns: int, frame: str) -> Any:
    return message("std_msgs/msg/Header", stamp=stamp(stamp_ns), frame_id=frame)


def transform(parent: str, child: str, pose: Pose, stamp_ns: int) -> Any:
    (x, y, z), (qx, qy, qz, qw) = pose.position, pose.quaternion_xyzw
    return message(
        "geometry_msgs/msg/TransformStamped",
        header=header(stamp_ns, parent),
        child_frame_id=child,
        transform=message(
            "geometry_msgs/msg/Transform",
            translation=message("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
            rotation=message("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
        ),
    )


def transforms(*each: Any) -> Any:
    return message("tf2_msgs/msg/TFMessage", transforms=list(each))


def a_bool(state: str) -> Any:
    return message("std_msgs/msg/Bool", data=state == "closed")


def a_width(state: str) -> Any:
    return message("std_msgs/msg/Float64", data=0.08 if state == "open" else 0.05)


def joints(state: str) -> Any:
    return message(
        "sensor_msgs/msg/JointState",
        header=header(0, ""),
        name=["wrist", "finger"],
        position=np.array([1.0, 0.04 if state == "open" else 0.02]),
        velocity=np.array([]),
        effort=np.array([]),
    )


@dataclass
class BagMaker:
    """What a bag is to hold: (time [ns], topic, type, message)."""

    messages: list[tuple[int, str, str, Any]] = field(default_factory=list)

    def tf(self, at_ns: int, *each: Any, topic: str = "/tf") -> None:
        self.messages.append((at_ns, topic, "tf2_msgs/msg/TFMessage", transforms(*each)))

    def say(self, at_ns: int, topic: str, kind: str, what: Any) -> None:
        self.messages.append((at_ns, topic, kind, what))

    def write(self, path: Path, storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
        with Writer(path, version=9, storage_plugin=storage) as writer:
            kinds = {topic: kind for _, topic, kind, _ in self.messages}
            connections = {t: writer.add_connection(t, kind, typestore=STORE) for t, kind in kinds.items()}
            for at_ns, topic, kind, what in sorted(self.messages, key=lambda each: each[0]):
                writer.write(connections[topic], at_ns, STORE.serialize_cdr(what, kind))
        return path


def bag_of(
    recording: Recording, gripper: Callable[[str], Any] = a_bool, topic: str = "/gripper_closed",
    header_offset_ns: int = 0, names: Callable[[str], str] = str,
) -> BagMaker:  # fmt: skip
    """A recording as a robot tells it: base -> flange (moving) -> tool0 (fixed), base -> camera (fixed) -> objects.

    Header stamps are off by `header_offset_ns`, as those of a simulated clock are.
    """
    maker, start_ns = BagMaker(), recording.gripper[0].stamp_ns
    fixed = [transform("base", "camera", CAMERA, 0), transform("flange", "tool0", WRIST.inverse(), 0)]
    maker.tf(start_ns, *fixed, topic="/tf_static")
    for name, track in recording.tracks.items():
        for at_ns, position, quaternion in zip(track.stamps_ns.tolist(), track.positions, track.quaternions_xyzw,
                                               strict=True):  # fmt: skip
            pose, stamp_ns = Pose.of(position, quaternion), at_ns + header_offset_ns
            told = (
                transform("base", "flange", pose @ WRIST, stamp_ns)
                if name == recording.end_effector_frame
                else transform("camera", names(name), CAMERA.inverse() @ pose, stamp_ns)
            )
            maker.tf(at_ns, told)
    for sample in recording.gripper:
        what = gripper(sample.state)
        maker.say(sample.stamp_ns, topic, what.__msgtype__, what)
    maker.say(start_ns, "/rosout", "std_msgs/msg/String", message("std_msgs/msg/String", data="hello"))
    return maker
