"""Import of demonstrations as matiov/learn-BTs-from-demo stores them, in YAML: recordings of the cell `imported`.

    DIR/info.yaml             `frames` and the `default_frame`, which becomes the base frame
    DIR/demoN/data_K.yaml     the K-th action: `type`, the end-effector in every frame (`vec_pos` [m], `vec_quat` xyzw)

The format has no clock, so the stamps are made up, always the same way; and it has no sightings between the actions,
so none are invented: each action brings the poses of its own moment, and no rest pose follows from them.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from learner.errors import LearnerError
from learner.model import Pose, check_name
from recorder.errors import ImportRefusedError
from recorder.recording import Demonstrated, RecordingWriter
from recorder.wire import ACTION, GRIPPER, NS, POSES, pose_message

CELL: Final = "imported"
END_EFFECTOR: Final = "end_effector"
FIRST_NS: Final = 1_577_836_800 * NS
"""The made-up start of every imported demonstration: the beginning of 2020."""
SPACING_NS: Final = 3 * NS
"""Between two actions: far more than a rest pose is looked for after a release, less than an object is remembered."""
GRASP_NS: Final = NS // 2
"""From an action to the gripper's new state."""
_DEMO: Final = re.compile(r"demo([0-9]+)")
_DATA: Final = re.compile(r"data_([1-9][0-9]*)\.yaml")
_TYPES: Final = ("pick", "place", "drop")


@dataclass(frozen=True)
class Skipped:
    """A file that was left out, and why."""

    file: Path
    reason: str


@dataclass(frozen=True)
class Imported:
    """What became of a folder: recordings written now, those that were there already, files left out."""

    imported: tuple[Path, ...]
    known: tuple[Path, ...]
    skipped: tuple[Skipped, ...]


@dataclass(frozen=True)
class _Step:
    """An action with the end-effector's pose in the base and in every object's frame."""

    type: str
    end_effector_in: Mapping[str, Pose]

    def poses_in_base(self, base_frame: str) -> dict[str, Pose]:
        """The end-effector and every object: T_base_object = T_base_ee @ inv(T_object_ee)."""
        end_effector = self.end_effector_in[base_frame]
        objects = {
            name: end_effector @ pose.inverse() for name, pose in self.end_effector_in.items() if name != base_frame
        }
        return {END_EFFECTOR: end_effector, **objects}


def import_folder(source: Path, recordings: Path, task: str, user: str) -> Imported:
    """Write the demonstrations below `source` as recordings below `recordings`/imported; what is there stays as it is.

    Everything is read and checked before anything is written. Raises ImportRefusedError with the file and the reason,
    NameRefusedError for a bad name, OSError if a file cannot be read or written.
    """
    check_name("task", task)
    check_name("user", user)
    base_frame, objects = _read_info(source)
    folders = _demonstrations(source)
    skipped = [found for folder in folders for found in _left_out(folder)]
    found: dict[Path, tuple[Demonstrated, Sequence[_Step]]] = {}
    for folder in folders:
        steps: Sequence[_Step] = [_read_step(file, base_frame, objects) for file in _data_files(folder)]
        demonstrated = _demonstrated(task, user, base_frame, objects, steps)
        found[recordings / CELL / f"{demonstrated.demonstration_id}.mcap"] = (demonstrated, steps)
    known = tuple(file for file in found if file.exists())
    for file, content in found.items():
        if file not in known:
            _write(file, *content)
    return Imported(tuple(file for file in found if file not in known), known, tuple(skipped))


def _read_info(source: Path) -> tuple[str, tuple[str, ...]]:
    """The base frame and the objects."""
    file = source / "info.yaml"
    if not file.is_file():
        raise ImportRefusedError(
            source, "it has no info.yaml; give the folder that holds info.yaml and demo1, demo2, ..."
        )
    info = _read_yaml(file)
    frames, base_frame = info.get("frames"), info.get("default_frame")
    if not isinstance(frames, list) or base_frame is None:
        raise ImportRefusedError(file, "it needs a list `frames` and a `default_frame`")
    try:
        objects = tuple(check_name("object", name) for name in frames if name != base_frame)
        base_frame = check_name("frame", base_frame)
    except LearnerError as error:
        raise ImportRefusedError(file, str(error)) from error
    if not objects or len(set(objects)) < len(objects) or END_EFFECTOR in (base_frame, *objects):
        raise ImportRefusedError(
            file, f"`frames` needs frames other than {base_frame}, each once, and none called {END_EFFECTOR}"
        )
    return base_frame, objects


def _demonstrations(source: Path) -> list[Path]:
    folders = {int(match[1]): path for path in source.iterdir() if (match := _DEMO.fullmatch(path.name))}
    if not folders:
        raise ImportRefusedError(source, "it has no folder demo1, demo2, ...")
    return [folders[number] for number in sorted(folders)]


def _left_out(folder: Path) -> Iterator[Skipped]:
    for path in sorted(folder.iterdir()):
        if not _DATA.fullmatch(path.name):
            yield Skipped(path, "its name is not data_<K>.yaml, so it is no action of this demonstration")


def _data_files(folder: Path) -> list[Path]:
    files = {int(match[1]): path for path in folder.iterdir() if (match := _DATA.fullmatch(path.name))}
    if not files:
        raise ImportRefusedError(folder, "it has no data_1.yaml; remove the folder or add its actions")
    missing = next((number for number in range(1, max(files) + 1) if number not in files), None)
    if missing is not None:
        raise ImportRefusedError(folder, f"data_{missing}.yaml is missing, although later actions are there")
    return [files[number] for number in sorted(files)]


def _read_step(file: Path, base_frame: str, objects: Sequence[str]) -> _Step:
    data = _read_yaml(file)
    kind = data.get("type")
    if kind not in _TYPES:
        raise ImportRefusedError(file, f"its type is {kind!r}, not pick, place or drop")
    positions, quaternions = data.get("vec_pos"), data.get("vec_quat")
    if not isinstance(positions, dict) or not isinstance(quaternions, dict):
        raise ImportRefusedError(file, "it needs `vec_pos` and `vec_quat`, each by frame")
    poses = {frame: _read_pose(file, frame, positions, quaternions) for frame in (base_frame, *objects)}
    return _Step(kind, poses)


def _read_pose(file: Path, frame: str, positions: Mapping[str, Any], quaternions: Mapping[str, Any]) -> Pose:
    for name, values in (("vec_pos", positions), ("vec_quat", quaternions)):
        numbers = values.get(frame)
        if not isinstance(numbers, list) or not all(type(number) in (int, float) for number in numbers):
            raise ImportRefusedError(file, f"its `{name}` has no list of numbers for the frame {frame}")
    try:
        return Pose.of(positions[frame], quaternions[frame])
    except (LearnerError, OverflowError) as error:
        raise ImportRefusedError(file, f"the pose in {frame} is none: {error}") from error


def _read_yaml(file: Path) -> dict[str, Any]:
    try:
        data = yaml.safe_load(file.read_bytes())
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ImportRefusedError(file, f"it is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict):
        raise ImportRefusedError(file, "it is not a YAML mapping")
    return data


def _demonstrated(
    task: str, user: str, base_frame: str, objects: tuple[str, ...], steps: Sequence[_Step]
) -> Demonstrated:
    content = [
        [step.type, sorted((name, pose.position, pose.quaternion_xyzw) for name, pose in step.end_effector_in.items())]
        for step in steps
    ]
    digest = hashlib.sha256(json.dumps([task, user, base_frame, objects, content]).encode()).hexdigest()
    return Demonstrated(
        demonstration_id=f"{task[:40]}-{digest[:16]}",
        task=task,
        user=user,
        cell=CELL,
        base_frame=base_frame,
        end_effector_frame=END_EFFECTOR,
        objects=objects,
        outcome="success",
        start_ns=FIRST_NS,
    )


def _write(file: Path, demonstrated: Demonstrated, steps: Sequence[_Step]) -> None:
    file.with_name(file.name + ".part").unlink(missing_ok=True)  # of an import that was interrupted
    with RecordingWriter(file, demonstrated) as writer:
        _write_gripper(writer, FIRST_NS, "open")
        for number, step in enumerate(steps):
            stamp_ns = FIRST_NS + NS + number * SPACING_NS
            poses = pose_message(stamp_ns, demonstrated.base_frame, step.poses_in_base(demonstrated.base_frame))
            writer.write(POSES, poses, stamp_ns)
            writer.write(ACTION, _json({"stamp_ns": stamp_ns, "type": step.type}), stamp_ns)
            for later_ns in (GRASP_NS, GRASP_NS + NS, GRASP_NS + 2 * NS):
                _write_gripper(writer, stamp_ns + later_ns, "closed" if step.type == "pick" else "open")
        writer.finish()


def _write_gripper(writer: RecordingWriter, stamp_ns: int, state: str) -> None:
    writer.write(GRIPPER, _json({"stamp_ns": stamp_ns, "state": state, "width_m": None}), stamp_ns)


def _json(document: Mapping[str, Any]) -> bytes:
    return json.dumps(document).encode()
