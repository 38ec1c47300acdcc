"""Where a tree brings things, for the picture of the table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from learner.model import Pose, Tree
from learner.model.condition import ObjectAt, ObjectRoughlyAt
from learner.model.frame import START, objects_of, pose_of
from learner.model.tree import is_reference
from pipelines.panel.table import Destination

Goal = ObjectAt | ObjectRoughlyAt
PLACES = ("ObjectAt", "ObjectPosedAt", "ObjectRoughlyAt")


def goals_of(tree: Tree) -> tuple[Goal, ...]:
    """The places that a tree's conditions name, each once, without what only recovers.

    A place of what is found only while the tree runs is none that could be drawn before.
    """
    nodes = (node for node in tree.flattened(recovery=False).walk() if node.kind in PLACES)
    words = (node.word for node in nodes if not any(is_reference(value) for _, value in node.ports))
    return tuple(dict.fromkeys(word for word in words if isinstance(word, ObjectAt | ObjectRoughlyAt)))


def destinations(goals: Sequence[Goal], poses: Mapping[str, Pose], base: str) -> tuple[Destination, ...]:
    """The goals in the base frame, as far as their frames are seen; how things stood at the start nobody sees."""
    return tuple(_destinations(goals, {**poses, base: Pose((0.0, 0.0, 0.0))}))


def _destinations(goals: Sequence[Goal], poses: Mapping[str, Pose]) -> Iterator[Destination]:
    for goal in goals:
        if all(name in poses for name in objects_of(goal.frame)) and not goal.frame.endswith(START):
            at = pose_of(goal.frame, poses.__getitem__).apply(goal.position)
            yield Destination(goal.object, at, goal.radius)
