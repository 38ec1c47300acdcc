"""A rosbag2 becomes one recording of the cell `imported`: poses, gripper, presses where there are any, and the rest
byte for byte.

Without an `/action` topic (`std_msgs/String` that holds the JSON of CONTRACT, section 1) it is a demonstration by hand.
"""

from __future__ import annotations

import hashlib
import heapq
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final

from mcap.records import Channel, Schema

from learner.errors import LearnerError
from learner.model import check_name
from learner.model.poses import Poses
from recorder.errors import ImportRefusedError
from recorder.imports.bag import TEXT, TF, Bag, Topic, opened
from recorder.imports.grippers import Meaning
from recorder.imports.transforms import NoChainError, Stamps, Transforms, by_stamp
from recorder.imports.yaml_import import CELL, Imported, Skipped
from recorder.recording import Demonstrated, RecordingWriter
from recorder.wire import ACTION, GRIPPER, POSES, pose_message

BASES: Final = ("base", "base_link", "base_frame", "world", "map", "odom")
"""What a base frame is called where nobody says: the first of these that is there."""
END_EFFECTORS: Final = (
    "tool0",
    "tcp",
    "end_effector",
    "ee_link",
    "gripper_tcp",
    "panda_hand_tcp",
    "panda_hand",
    "gripper",
)
"""The same of the end-effector."""
FOREIGN: Final = 1000
"""Channels of topics that are kept as they are have numbers from here on."""
_ILLEGAL: Final = re.compile(r"[^A-Za-z0-9._-]")


@dataclass(frozen=True)
class Wanted:
    """What to make of a bag; `objects` are patterns of frames (None: every measured frame that is not the robot's)."""

    task: str
    user: str
    gripper: str
    base: str | None = None
    end_effector: str | None = None
    objects: Sequence[str] = ()
    meaning: Meaning = field(default_factory=Meaning)


def import_bag(path: Path, recordings: Path, wanted: Wanted) -> Imported:
    """Write what a bag holds as a recording below `recordings`/imported; one that is there stays as it is.

    Raises ImportRefusedError with what is missing and what the bag holds, NameRefusedError for a bad name, OSError if a
    file cannot be read or written.
    """
    check_name("task", wanted.task)
    check_name("user", wanted.user)
    with opened(path) as bag:
        scene = _Scene.of(bag, wanted)
        demonstrated = _demonstrated(bag, scene, wanted)
        file = recordings / CELL / f"{demonstrated.demonstration_id}.mcap"
        if file.exists():
            return Imported((), (file,), ())
        _write(file, demonstrated, bag, scene)
        left_out = (Skipped(path, f"{count} {what} were left out") for what, count in sorted(bag.left_out.items()))
        return Imported((file,), (), (*left_out, *scene.skipped))


@dataclass(frozen=True)
class _Scene:
    """The frames of a demonstration by the names that they get, where each was when, and what the gripper said."""

    base: str
    end_effector: str
    tracks: dict[str, tuple[Stamps, Poses]]
    gripper: list[tuple[int, str]]
    skipped: tuple[Skipped, ...]

    @staticmethod
    def of(bag: Bag, wanted: Wanted) -> _Scene:
        """Raises ImportRefusedError where something that is needed is missing."""
        transforms = bag.transforms()
        if not transforms.links:
            raise ImportRefusedError(bag.path, f"it has no transforms ({TF}); the bag holds {bag.holds()}")
        gripper = bag.gripper(wanted.gripper, wanted.meaning)
        base = _chosen("base frame", "--base", wanted.base, BASES, transforms, bag.path)
        hand = _chosen("end-effector frame", "--end-effector", wanted.end_effector, END_EFFECTORS, transforms, bag.path)
        names = _objects(transforms, base, hand, wanted.objects, bag.path)
        tracks, skipped = dict[str, tuple[Stamps, Poses]](), list[Skipped]()
        for frame, name in {hand: _named(hand, bag.path), **names}.items():
            try:
                stamps_ns, poses = transforms.track(frame, base)
            except NoChainError as error:
                if frame == hand or wanted.objects:
                    raise ImportRefusedError(bag.path, str(error)) from error
                skipped.append(Skipped(bag.path, f"the frame {frame} is no object: {error}"))
                continue
            if len(stamps_ns):
                tracks[name] = stamps_ns, poses
        if len(tracks) < 2:
            raise ImportRefusedError(bag.path, _nothing_seen(transforms, base))
        return _Scene(_named(base, bag.path), _named(hand, bag.path), tracks, gripper, tuple(skipped))


def _chosen(what: str, option: str, asked: str | None, usual: Sequence[str], transforms: Transforms, path: Path) -> str:
    frames = transforms.frames
    if asked is not None and asked.lstrip("/") in frames:
        return asked.lstrip("/")
    found = next((name for name in usual if name in frames), None) if asked is None else None
    if found is None and asked is None and what.startswith("base") and len(transforms.roots) == 1:
        found = transforms.roots[0]
    if found is None:
        missing = f"no frame {asked!r}" if asked is not None else f"no frame that is known as {what}"
        raise ImportRefusedError(path, f"it has {missing}; name one with {option}; its frames are {', '.join(frames)}")
    return found


def _objects(transforms: Transforms, base: str, hand: str, patterns: Sequence[str], path: Path) -> dict[str, str]:
    """The frames that are objects, with the names that they get."""
    others = [frame for frame in transforms.frames if frame not in (base, hand)]
    if patterns:
        chosen = [f for f in others if any(fnmatchcase(f, pattern.lstrip("/")) for pattern in patterns)]
    else:
        chosen = [frame for frame in others if not _is_of_the_robot(frame, base, hand, transforms)]
    if not chosen:
        asked = f"matches {', '.join(patterns)}" if patterns else "is measured and not the robot's"
        raise ImportRefusedError(
            path, f"no frame {asked}; name the objects' with --objects; its frames are {', '.join(transforms.frames)}"
        )
    named = {frame: _named(frame, path) for frame in chosen}
    if len({*named.values(), _named(base, path), _named(hand, path)}) < len(named) + 2:
        raise ImportRefusedError(path, f"of its frames {', '.join(chosen)} two would get the same name")
    return named


def _is_of_the_robot(frame: str, base: str, hand: str, transforms: Transforms) -> bool:
    """Whether a frame lies between the base and the end-effector, above the base, is carried by the robot, or carries
    others itself (a camera): none of these is taken in hand.
    """
    if frame not in transforms.links or any(link.parent == frame for link in transforms.links.values()):
        return True
    try:
        arm = {link.child for link in transforms.up(hand)} - {link.child for link in transforms.up(base)}
        down = transforms.up(frame)
    except NoChainError:
        return False
    return all(link.static for link in down[:1]) and any(link.child in arm for link in down)


def _named(frame: str, path: Path) -> str:
    """A frame's name as the contract admits it: what it does not, becomes `_`."""
    try:
        return check_name("frame", _ILLEGAL.sub("_", frame).lstrip("._-")[:64])
    except LearnerError as error:
        raise ImportRefusedError(path, str(error)) from error


def _nothing_seen(transforms: Transforms, base: str) -> str:
    return f"no object was ever measured together with {base}; its frames are {', '.join(transforms.frames)}"


def _demonstrated(bag: Bag, scene: _Scene, wanted: Wanted) -> Demonstrated:
    digest = hashlib.sha256(repr((wanted, scene.base, scene.end_effector, sorted(scene.tracks))).encode())
    for topic, stamp_ns, data in bag.raw(set(bag.topics)):
        digest.update(f"{topic}\0{stamp_ns}\0{len(data)}\0".encode() + data)
    return Demonstrated(
        demonstration_id=f"{wanted.task[:40]}-{digest.hexdigest()[:16]}",
        task=wanted.task,
        user=wanted.user,
        cell=CELL,
        base_frame=scene.base,
        end_effector_frame=scene.end_effector,
        objects=tuple(sorted(set(scene.tracks) - {scene.end_effector})),
        outcome="success",
        start_ns=min(int(stamps_ns[0]) for stamps_ns, _ in scene.tracks.values()),
    )


def what_it_holds(path: Path) -> str:
    """The topics of a bag, in words. Raises ImportRefusedError."""
    with opened(path) as bag:
        return bag.holds()


def _write(file: Path, demonstrated: Demonstrated, bag: Bag, scene: _Scene) -> None:
    file.with_name(file.name + ".part").unlink(missing_ok=True)  # of an import that was interrupted
    foreign = {name: number for number, name in enumerate(sorted(bag.topics), start=FOREIGN)}
    with RecordingWriter(file, demonstrated) as writer:
        for name, number in foreign.items():
            _tell(writer, number, bag.topics[name])
        ours, theirs = _ours(bag, scene), bag.raw(set(bag.topics))
        merged = heapq.merge(
            ((stamp_ns, 0, topic, data) for stamp_ns, topic, data in ours),
            ((stamp_ns, 1, topic, data) for topic, stamp_ns, data in theirs),
            key=lambda each: each[:2],
        )
        for stamp_ns, rank, topic, data in merged:
            if rank:
                writer.append(foreign[topic], 0, stamp_ns, stamp_ns, data)
            else:
                writer.write(topic, data, stamp_ns)
        writer.finish()


def _ours(bag: Bag, scene: _Scene) -> Iterator[tuple[int, str, bytes]]:
    """Stamp [ns], topic and payload of what the contract asks for, in order."""
    poses = ((ns, POSES, pose_message(ns, scene.base, found)) for ns, found in by_stamp(scene.tracks))
    states = sorted(scene.gripper)
    gripper = ((ns, GRIPPER, _json({"stamp_ns": ns, "state": state, "width_m": None})) for ns, state in states)
    pressed = [(ns, ACTION, str(m.data).encode()) for _, ns, m in bag.messages({TEXT}, {ACTION})]
    yield from heapq.merge(poses, gripper, pressed, key=lambda each: each[0])


def _tell(writer: RecordingWriter, number: int, topic: Topic) -> None:
    """Tell of a topic that is kept as it is; one of ours gets another name, so that none is taken for the other."""
    name = topic.name if topic.name not in (POSES, GRIPPER, ACTION) else f"/bag{topic.name}"
    schema = Schema(id=number, name=topic.type, encoding=topic.definition_format, data=topic.definition.encode())
    channel = Channel(number, name, "cdr", {}, number if topic.definition else 0)
    writer.adopt(channel, schema if topic.definition else None)


def _json(document: dict[str, object]) -> bytes:
    return json.dumps(document).encode()
