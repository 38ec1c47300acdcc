"""From the files of a demonstration to its recording, on one timeline."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from learner.model import Recording, Scene, Track
from recorder.clocks import Arrived, Straight, straighten
from recorder.errors import NotARecordingError, RecorderError
from recorder.recording.decoding import ReadFile
from recorder.recording.demonstrated import parse_scene
from recorder.recording.parts import in_order
from recorder.recording.reader import sha256_of
from recorder.wire import Sighting


def read_recording(paths: Sequence[Path]) -> Recording:
    """The recording in one file, or in the parts of a split one (given in any order).

    Poses relative to another frame than the base are no sightings; messages and poses that say nothing (no finite
    position, no rotation, no stamp) are left out, and `notes` tell of them. Of exactly equal presses one is kept. All
    is on one timeline, also where clocks were set (see recorder.clocks).

    Raises NotARecordingError for a file that is none or is damaged, TornRecordingError for one that ends before its
    end, PartMissingError for a split one that is not all there, OSError if a file cannot be read.
    """
    if not paths:
        raise RecorderError("a recording is at least one file")
    read = [ReadFile(file) for file in paths]
    return join_files(read, sha256_of(in_order({each.file: each.demonstrated for each in read})))


def join_files(read: Sequence[ReadFile], sha256: str) -> Recording:
    """The recording of one file, or of all parts of a split one, whose bytes have this digest; raises as
    `read_recording` does.
    """
    by_file = {each.file: each for each in read}
    parts = [by_file[file] for file in in_order({each.file: each.demonstrated for each in read})]
    first, last = parts[0].demonstrated, parts[-1].demonstrated
    scene = next((part.demonstrated.scene for part in parts if part.demonstrated.scene), None)
    straight = _straight(first.base_frame, parts)
    return Recording(
        demonstration_id=first.demonstration_id,
        task=first.task,
        user=first.user,
        cell=first.cell,
        base_frame=first.base_frame,
        end_effector_frame=first.end_effector_frame,
        objects=first.objects,
        outcome=last.outcome,
        tracks={child: _track(seen) for child, seen in sorted(straight.sightings.items()) if seen},
        gripper=tuple(sorted(straight.gripper, key=lambda sample: sample.stamp_ns)),
        presses=tuple(sorted(dict.fromkeys(straight.presses), key=lambda press: press.stamp_ns)),
        sha256=sha256,
        start_ns=first.start_ns,
        messages_lost=_joined_losses([part.demonstrated.messages_lost for part in parts]),
        scene=None if scene is None else _scene(parts[0].file, scene),
        parents=frozenset().union(*(part.parents for part in parts)),
        gaps=tuple(dict.fromkeys(gap for part in parts for gap in part.demonstrated.gaps)),
        notes=(*straight.notes, *dict.fromkeys(note for part in parts for note in part.oddities.sentences)),
    )


def _scene(file: Path, text: str) -> Scene:
    try:
        return parse_scene(text)
    except ValueError as error:
        raise NotARecordingError(file, str(error)) from error


def _joined_losses(parts: Sequence[Mapping[str, int | None] | None]) -> dict[str, int | None] | None:
    """Losses add up over the parts; what is unknown in one is unknown in all."""
    counted = [part for part in parts if part is not None]
    total: dict[str, int | None] = {}
    for part in counted:
        for topic, count in part.items():
            before = total.get(topic, 0)
            total[topic] = None if count is None or before is None else before + count
    return total if counted else None


def _straight(base_frame: str, parts: Sequence[ReadFile]) -> Straight:
    """What all parts hold, on one timeline."""
    joined: dict[str, list[Arrived[Sighting]]] = defaultdict(list)
    for part in parts:
        for (parent, child), sightings in part.sightings.items():
            if parent == base_frame:
                joined[child] += sightings
    gripper = [sample for part in parts for sample in part.gripper]
    return straighten(joined, gripper, [press for part in parts for press in part.presses])


def _track(sightings: Sequence[Sighting]) -> Track:
    stamps = np.array([seen.stamp_ns for seen in sightings], dtype=np.int64)
    numbers = np.array([(*seen.position, *seen.quaternion_xyzw) for seen in sightings], dtype=np.float64)
    order = np.argsort(stamps, kind="stable")
    return Track(stamps[order], numbers[order, :3], numbers[order, 3:])
