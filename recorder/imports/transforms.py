"""Chains of tf2 transforms, composed: where a frame was in another one, at the moments at which it was measured.

A frame is measured when the last moving link of its chain is: the others are taken between their own samples around
that moment. What is fixed to the base is told twice a second, so that it is never old.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from learner.model import Pose
from learner.model.poses import Poses
from recorder.wire import NS

Stamps = NDArray[np.int64]
BETWEEN_NS: Final = NS
"""Between two samples further apart than this [ns] nothing is told of a link ..."""
AFTER_NS: Final = NS // 2
"""... but for so long after the earlier one."""
FIXED_NS: Final = NS // 2
"""What does not move is told so often."""


class NoChainError(Exception):
    """A frame that cannot be told in another: a sentence without its subject's file."""


@dataclass
class Link:
    """The transforms of a child in its parent: sorted by stamp once they are `gathered`."""

    parent: str
    child: str
    static: bool
    samples: list[tuple[int, Pose]] = field(default_factory=list)

    def gathered(self) -> tuple[Stamps, Poses]:
        """Stamps [ns] (n,) in order, and the poses (n,)."""
        ordered = sorted(self.samples, key=lambda sample: sample[0])
        return np.array([stamp for stamp, _ in ordered], dtype=np.int64), Poses.of([pose for _, pose in ordered])


class Transforms:
    """Every link that a bag tells, by its child; frames form trees."""

    def __init__(self) -> None:
        self.links: dict[str, Link] = {}
        self.parents: dict[str, set[str]] = defaultdict(set)
        self.stamps_ns: list[int] = []

    @property
    def frames(self) -> list[str]:
        """The names of all frames, sorted."""
        return sorted({*self.links, *(parent for parents in self.parents.values() for parent in parents)})

    @property
    def roots(self) -> list[str]:
        """The frames that have no parent."""
        return [frame for frame in self.frames if frame not in self.links]

    def add(self, parent: str, child: str, stamp_ns: int, pose: Pose, static: bool) -> None:
        """Take one transform in; of a static link the last one counts."""
        self.parents[child].add(parent)
        known = self.links.get(child)
        if known is None or known.parent != parent or static:
            known = self.links[child] = Link(parent, child, static)
        known.samples.append((stamp_ns, pose))
        if not static:
            self.stamps_ns.append(stamp_ns)

    def up(self, frame: str) -> list[Link]:
        """The links from a frame to the root of its tree. Raises NoChainError for two parents, and for a ring."""
        chain: list[Link] = []
        while frame in self.links:
            if len(parents := sorted(self.parents[frame])) > 1:
                raise NoChainError(f"the frame {frame} has several parents, {' and '.join(parents)}; tf2 admits one")
            chain.append(self.links[frame])
            frame = chain[-1].parent
            if any(link.child == frame for link in chain):
                raise NoChainError(f"the frames {', '.join(link.child for link in chain)} form a ring")
        return chain

    def track(self, frame: str, base: str) -> tuple[Stamps, Poses]:
        """When a frame was measured [ns] (n,), and its poses in the base then. Raises NoChainError."""
        down, other = self.up(frame), self.up(base)
        if (down[-1].parent if down else frame) != (other[-1].parent if other else base):
            raise NoChainError(f"no chain of transforms leads from {base} to {frame}")
        common = {link.child for link in down} & {link.child for link in other}
        down = [link for link in down if link.child not in common]
        other = [link for link in other if link.child not in common]
        stamps_ns = self._measured(down, other)
        poses = _composed(other, stamps_ns).inverse() @ _composed(down, stamps_ns)
        return stamps_ns[poses.known], poses[poses.known]

    def _measured(self, down: list[Link], other: list[Link]) -> Stamps:
        moving = next((link for link in (*down, *other) if not link.static), None)
        if moving is not None:
            return np.unique(moving.gathered()[0])
        first, last = (min(self.stamps_ns), max(self.stamps_ns)) if self.stamps_ns else (0, 0)
        return np.arange(first, last + 1, FIXED_NS, dtype=np.int64)


def _composed(chain: list[Link], stamps_ns: Stamps) -> Poses:
    """The frame at the bottom of a chain in the one at its top, at some stamps (n,); unknown where a link is."""
    pose = Poses.identity(len(stamps_ns))
    for link in chain:
        pose = _at(link, stamps_ns) @ pose
    return pose


def _at(link: Link, stamps_ns: Stamps) -> Poses:
    """The child in the parent at some stamps (n,): between the samples around each."""
    times, poses = link.gathered()
    if link.static:
        return poses[np.full(len(stamps_ns), len(times) - 1)]
    behind = np.searchsorted(times, stamps_ns, side="right") - 1
    before, after = np.clip(behind, 0, None), np.clip(behind + 1, 0, len(times) - 1)
    span = times[after] - times[before]
    exact = times[before] == stamps_ns
    near = (behind >= 0) & (after > before) & (span <= BETWEEN_NS)
    held = (behind >= 0) & (stamps_ns - times[before] <= AFTER_NS)
    share = np.where(near & ~exact, (stamps_ns - times[before]) / np.maximum(span, 1), 0.0)
    found = _between(poses[before], poses[after], share)
    return found.where(exact | near | held, Poses.unknown(len(stamps_ns)))


def _between(ones: Poses, others: Poses, share: NDArray[np.float64]) -> Poses:
    """Row by row the pose a share of the way from one to another, turned the shorter way."""
    weight = share[:, None]
    sign = np.where((ones.quaternions_xyzw * others.quaternions_xyzw).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    quaternions = (1 - weight) * ones.quaternions_xyzw + weight * sign * others.quaternions_xyzw
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return Poses((1 - weight) * ones.positions + weight * others.positions, quaternions)


def by_stamp(tracks: Mapping[str, tuple[Stamps, Poses]]) -> Iterator[tuple[int, dict[str, Pose]]]:
    """The poses of all tracks, by name, stamp by stamp [ns]."""
    found: dict[int, dict[str, Pose]] = defaultdict(dict)
    for name, (stamps_ns, poses) in tracks.items():
        for row, stamp_ns in enumerate(stamps_ns.tolist()):
            found[stamp_ns][name] = poses.pose(row)
    yield from sorted(found.items())
