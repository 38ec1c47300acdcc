"""What may lie in the way: what the proof of a tree of vocabulary 2 knows of the objects beside what the tree says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from learner.model.pose import Pose, Vector


@dataclass(frozen=True)
class Things:
    """`grasps`: of each object that can be picked, the end-effector's pose in its frame. `upon`: where the origin of
    one is when it lies upon another [m], in that one's frame, by both names.
    """

    grasps: Mapping[str, Pose] = field(default_factory=dict)
    upon: Mapping[tuple[str, str], Vector] = field(default_factory=dict)


NO_THINGS: Final = Things()
