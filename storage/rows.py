"""Demonstrations as rows of the lake's tables, and back: the schemas stand between the writer and the reader.

A demonstration is one row of DEMONSTRATIONS and, in ACTIONS, one row per action and frame: the base frame and every
object known at the press. There `end_effector_in_frame` is what a Pick, Place or Drop executes in that frame and
`rest_in_frame` what it achieved; `candidate` is the frame's place among those in which the action may be expressed,
null if it may not. Lengths [m], quaternions xyzw, stamps [ns].
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence, Set
from itertools import groupby, islice
from typing import Any, Final

import numpy as np
import pyarrow as pa

from learner.model import DemonstratedAction, Demonstration, Pose, Scene
from learner.model.pose import conjugate, express, multiply
from learner.model.poses import Mask, Poses

Row = dict[str, Any]

POSE: Final = pa.struct([(name, pa.float64()) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")])
NAMED_POSES: Final = pa.list_(pa.struct([("object", pa.string()), ("pose", POSE)]))
SENTENCES: Final = pa.list_(pa.string())

DEMONSTRATIONS: Final = pa.schema(
    [
        ("demonstration_id", pa.string()),
        ("sha256", pa.string()),
        ("task", pa.string()),
        ("user", pa.string()),
        ("cell", pa.string()),
        ("base_frame", pa.string()),
        ("end_effector_frame", pa.string()),
        ("objects", pa.list_(pa.string())),
        ("outcome", pa.string()),
        ("start_ns", pa.int64()),
        ("actions", pa.int32()),
        ("initial", NAMED_POSES),
        ("final", NAMED_POSES),
        ("messages_lost", pa.string()),
        ("scene", pa.string()),
        ("warnings", SENTENCES),
        ("gaps", SENTENCES),
        ("files", pa.list_(pa.string())),
        ("ingested_ns", pa.int64()),
    ]
)
ACTIONS: Final = pa.schema(
    [
        ("type", pa.string()),
        ("object", pa.string()),
        ("frame", pa.string()),
        ("task", pa.string()),
        ("user", pa.string()),
        ("demonstration_id", pa.string()),
        ("sha256", pa.string()),
        ("step", pa.int32()),
        ("stamp_ns", pa.int64()),
        ("candidate", pa.int32()),
        ("frame_in_base", POSE),
        ("end_effector_in_frame", POSE),
        ("rest_in_frame", POSE),
        ("rest_known", pa.bool_()),
        ("rest_seen", pa.bool_()),
        ("warnings", SENTENCES),
    ]
)
ACTION_ORDER: Final = ("type", "object", "frame", "demonstration_id", "step")
END_EFFECTOR: Final = "end_effector_in_frame"
POSE_COLUMNS: Final = ("frame_in_base", END_EFFECTOR, "rest_in_frame")


def demonstration_rows(
    demonstrations: Iterable[Demonstration], files: Mapping[str, Sequence[str]], ingested_ns: int
) -> pa.Table:
    """The rows of DEMONSTRATIONS; `files` are the recordings that each came from, by its id."""
    rows = [_demonstration_row(each, files.get(each.demonstration_id, ()), ingested_ns) for each in demonstrations]
    return pa.Table.from_pylist(rows, DEMONSTRATIONS)


def action_rows(demonstrations: Iterable[Demonstration]) -> pa.Table:
    """The rows of ACTIONS."""
    rows = [row for d in demonstrations for action in d.actions for row in _frame_rows(d, action)]
    return pa.Table.from_pylist(rows, ACTIONS)


def read_demonstrations(demonstrations: pa.Table, actions: pa.Table) -> list[Demonstration]:
    """The demonstrations of the rows, exactly as they were written, mappings in the order of their names.

    Rows of ACTIONS without their demonstration, as an interrupted ingest leaves them, are passed over.
    """
    found, scenes = _read_actions(actions, dict(_bases(demonstrations))), demonstrations["scene"].unique().to_pylist()
    known = {text: None if text is None else Scene.of_data(json.loads(text)) for text in scenes}
    initial, final = (_read_named_poses(demonstrations[name]) for name in ("initial", "final"))
    rows = demonstrations.drop_columns(["initial", "final"]).to_pylist()
    rows = [row | {"initial": begin, "final": end} for row, begin, end in zip(rows, initial, final, strict=True)]
    return [_read_demonstration(row, found, known) for row in rows]


def _demonstration_row(demonstration: Demonstration, files: Sequence[str], ingested_ns: int) -> Row:
    row = {name: getattr(demonstration, name) for name in DEMONSTRATIONS.names if hasattr(demonstration, name)}
    return row | {
        "actions": len(demonstration.actions),
        "initial": _named_poses(demonstration.initial),
        "final": _named_poses(demonstration.final),
        "messages_lost": None if demonstration.messages_lost is None else _json(dict(demonstration.messages_lost)),
        "scene": None if demonstration.scene is None else _json(demonstration.scene.to_data()),
        "files": list(files),
        "ingested_ns": ingested_ns,
    }


def _read_demonstration(
    row: Row,
    actions: Mapping[tuple[str, str], list[DemonstratedAction]],
    scenes: Mapping[str | None, Scene | None],
) -> Demonstration:
    lost, scene = row.pop("messages_lost"), row.pop("scene")
    for bookkeeping in ("files", "ingested_ns", "actions"):
        row.pop(bookkeeping)
    for name in ("objects", "warnings", "gaps"):
        row[name] = tuple(row[name])
    return Demonstration(
        **row,
        actions=tuple(actions.get((row["demonstration_id"], row["sha256"]), ())),
        messages_lost=None if lost is None else json.loads(lost),
        scene=scenes[scene],
    )


def _frame_rows(demonstration: Demonstration, action: DemonstratedAction) -> list[Row]:
    shared = {name: getattr(demonstration, name) for name in ("task", "user", "demonstration_id", "sha256")}
    for name in ("step", "stamp_ns", "type", "object", "rest_seen", "warnings"):
        shared[name] = getattr(action, name)
    candidates = {frame: index for index, frame in enumerate(action.frames)}
    rest = action.rest or {}
    others = sorted({*action.objects, *action.frames, *rest} - {demonstration.base_frame})
    end_effectors = _in_frames(action) | {demonstration.base_frame: action.end_effector}
    return [
        shared
        | {
            "frame": frame,
            "candidate": candidates.get(frame),
            "frame_in_base": _pose_data(action.objects.get(frame)),
            "end_effector_in_frame": _pose_data(end_effectors.get(frame)),
            "rest_in_frame": _pose_data(rest.get(frame)),
            "rest_known": action.rest is not None,
        }
        for frame in (demonstration.base_frame, *others)
    ]


def _in_frames(action: DemonstratedAction) -> dict[str, Pose]:
    """The end-effector in the frame of each object known at the press."""
    if not action.objects:
        return {}
    positions = np.array([pose.position for pose in action.objects.values()])
    quaternions = np.array([pose.quaternion_xyzw for pose in action.objects.values()])
    inside = express(np.array(action.end_effector.position), positions, quaternions)
    turned = multiply(conjugate(quaternions), np.array(action.end_effector.quaternion_xyzw))
    return {name: Pose.of(p, q) for name, p, q in zip(action.objects, inside, turned, strict=True)}


def _bases(demonstrations: pa.Table) -> Iterable[tuple[tuple[str, str], str]]:
    names = ("demonstration_id", "sha256", "base_frame")
    ids, digests, bases = (demonstrations[name].to_pylist() for name in names)
    return zip(zip(ids, digests, strict=True), bases, strict=True)


def _read_actions(
    actions: pa.Table, bases: Mapping[tuple[str, str], str]
) -> dict[tuple[str, str], list[DemonstratedAction]]:
    rows = _rows(actions, set(bases.values()))
    rows.sort(key=lambda row: (row["demonstration_id"], row["sha256"], row["step"], row["frame"]))
    found: dict[tuple[str, str], list[DemonstratedAction]] = {}
    for (name, digest, _), frames in groupby(rows, lambda row: (row["demonstration_id"], row["sha256"], row["step"])):
        if (name, digest) in bases:
            action = _read_action(list(frames), bases[name, digest])
            found.setdefault((name, digest), []).append(action)
    return found


def _read_action(rows: list[Row], base_frame: str) -> DemonstratedAction:
    first = rows[0]
    candidates = sorted((row["candidate"], row["frame"]) for row in rows if row["candidate"] is not None)
    return DemonstratedAction(
        step=first["step"],
        stamp_ns=first["stamp_ns"],
        type=first["type"],
        object=first["object"],
        end_effector=next(row[END_EFFECTOR] for row in rows if row["frame"] == base_frame),
        objects={row["frame"]: row["frame_in_base"] for row in rows if row["frame_in_base"] is not None},
        frames=tuple(frame for _, frame in candidates),
        rest={row["frame"]: row["rest_in_frame"] for row in rows if row["rest_in_frame"] is not None}
        if first["rest_known"]
        else None,
        rest_seen=first["rest_seen"],
        warnings=tuple(first["warnings"]),
    )


def _rows(actions: pa.Table, bases: Set[str]) -> list[Row]:
    """The rows with their poses read; by column, which is far quicker than by row, and no column in vain: the
    demonstrations tell task and user, and an action keeps its end-effector in the base alone.
    """
    plain = [name for name in ACTIONS.names if name not in ("task", "user", *POSE_COLUMNS)]
    columns: dict[str, list[Any]] = {name: actions[name].to_pylist() for name in plain}
    in_base = np.array([frame in bases for frame in columns["frame"]], dtype=np.bool_)
    columns |= {name: _poses(actions[name].combine_chunks()) for name in POSE_COLUMNS if name != END_EFFECTOR}
    columns[END_EFFECTOR] = _poses(actions[END_EFFECTOR].combine_chunks(), in_base)
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def _poses(column: pa.Array, wanted: Mask | None = None) -> list[Pose | None]:
    """The poses of a column, None where it tells none, or where it is not `wanted` (n,)."""
    known = np.asarray(column.is_valid())
    known = known if wanted is None else known & wanted
    fields = column.flatten()
    numbers = np.column_stack([np.asarray(field, dtype=np.float64) for field in fields])
    found = np.full(len(known), None, dtype=object)
    found[known] = Poses.from_rows(numbers[known]).each()
    return found.tolist()


def _pose_data(pose: Pose | None) -> Row | None:
    if pose is None:
        return None
    return dict(zip(POSE.names, (*pose.position, *pose.quaternion_xyzw), strict=True))


def _named_poses(poses: Mapping[str, Pose]) -> list[Row]:
    return [{"object": name, "pose": _pose_data(poses[name])} for name in sorted(poses)]


def _read_named_poses(column: pa.ChunkedArray) -> list[dict[str, Pose]]:
    lists = column.combine_chunks()
    entries = lists.flatten()
    named = iter(zip(entries.field("object").to_pylist(), _poses(entries.field("pose")), strict=True))
    return [dict(islice(named, length)) for length in lists.value_lengths().to_pylist()]  # type: ignore[arg-type]  # every pose is known


def _json(data: Any) -> str:
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
