"""A recording as it was made: poses, the gripper's states and the operator's presses, before any judgement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from learner.model.condition import GripperState
from learner.model.scene import Scene


@dataclass(frozen=True)
class Track:
    """The poses of one child frame in the base, sorted by stamp (FrameTransform.timestamp).

    stamps_ns: (n,) int64; positions [m]: (n, 3); quaternions_xyzw: (n, 4), unit.
    """

    stamps_ns: NDArray[np.int64]
    positions: NDArray[np.float64]
    quaternions_xyzw: NDArray[np.float64]


@dataclass(frozen=True)
class GripperSample:
    """The gripper at a stamp; `width_m` is None where the gripper does not tell."""

    stamp_ns: int
    state: GripperState
    width_m: float | None


@dataclass(frozen=True)
class ActionPress:
    """The operator's press of a button: `type` is 'pick', 'place', 'drop', 'signal' or 'undo'.

    The `object` of the first three may be left out; `signal` and `value` are those of a machine's signal that is set.
    """

    stamp_ns: int
    type: str
    object: str | None
    signal: str | None = None
    value: bool | float | str | None = None


@dataclass(frozen=True)
class Recording:
    """One recorded demonstration, whole (the parts of a split one joined); gripper and presses sorted by stamp.

    `poses_parents` names the parent frames seen on /poses; anything but the base frame is refused later.
    `messages_lost` counts losses by topic, None where it cannot be known. `sha256` is over the file's bytes (of all
    parts in order).
    """

    demonstration_id: str
    task: str
    user: str
    cell: str
    base_frame: str
    end_effector_frame: str
    objects: tuple[str, ...]
    outcome: str
    tracks: Mapping[str, Track]
    gripper: tuple[GripperSample, ...]
    presses: tuple[ActionPress, ...]
    sha256: str
    start_ns: int | None = None
    messages_lost: Mapping[str, int | None] | None = None
    scene: Scene | None = None
    parents: frozenset[str] = frozenset()
    gaps: tuple[str, ...] = field(default=())
    """Sentences about gaps near an action (a loss that the recorder counted there)."""
    notes: tuple[str, ...] = ()
    """Sentences about what was odd in it: clocks that were set, stamps and messages that were left out."""
