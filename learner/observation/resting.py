"""Where a released object came to rest (CONTRACT, section 2: rest pose)."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from learner.model import GripperSample, Pose, Track
from learner.model.condition import DROP_RADIUS_M
from learner.model.holding import SLIP_M
from learner.model.pose import Array, Vector
from learner.observation.freshness import Freshness
from learner.observation.surroundings import Astray, Held, last


def rest_ns(
    track: Track, released_ns: int, next_ns: int | None, stale: Vector | None, freshness: Freshness
) -> int | None:
    """The end of the first 0.3 s after the release in which the object is seen and still; None if there is none.

    It lies before the next press on the object at `next_ns`, and not at the `stale` position.
    """
    first = bisect_right(track.stamps_ns, released_ns)
    behind = len(track.stamps_ns) if next_ns is None else last(track, next_ns) + 1
    for begin in range(first, behind):
        end_ns = int(track.stamps_ns[begin]) + freshness.window_ns
        end = min(last(track, end_ns) + 1, behind)
        positions = track.positions[begin:end]
        whole = (next_ns is None or end_ns <= next_ns) and _covers(track, begin, end, freshness.window_ns)
        if whole and _drift_m(positions) < freshness.still_m and not _is_near(positions, stale):
            return int(track.stamps_ns[end - 1])
    return None


def stale_position(held: Held, released: Pose, astray: Astray | None) -> Vector | None:
    """Where a released object cannot rest although it may be seen there; None if it can rest anywhere.

    That is where it was seen astray while it was held; and where it was picked, if it was let go further from there
    than a Drop scatters: the detection is of before, or of something else.
    """
    if astray is not None and not astray.in_hand:
        return astray.pose.position
    picked = held.objects[held.object].position
    return picked if math.dist(picked[:2], released.position[:2]) > DROP_RADIUS_M + SLIP_M else None


def released_ns(gripper: Sequence[GripperSample], pressed_ns: int, end_ns: int | None) -> int:
    """When the gripper opened after a press, before the next one at `end_ns`; else the press itself [ns]."""
    opened = (sample.stamp_ns for sample in gripper if sample.stamp_ns > pressed_ns and sample.state == "open")
    first = next(opened, pressed_ns)
    return first if end_ns is None or first < end_ns else pressed_ns


def _is_near(positions: Array, stale: Vector | None) -> bool:
    return stale is not None and float(np.linalg.norm(np.median(positions, axis=0) - stale)) <= SLIP_M


def _covers(track: Track, begin: int, end: int, window_ns: int) -> bool:
    """Whether the samples really span the window, so that a glimpse does not count as being seen."""
    span_ns = int(track.stamps_ns[end - 1] - track.stamps_ns[begin])
    return end - begin >= 3 and span_ns > window_ns // 2


def _drift_m(positions: Array) -> float:
    """How far the object moved over the samples (n, 3): between the medians of both halves, noise averaged out."""
    half = (len(positions) + 1) // 2
    return float(np.linalg.norm(np.median(positions[:half], axis=0) - np.median(positions[-half:], axis=0)))
