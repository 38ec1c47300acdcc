"""A world of poses in which trees are ticked: no gravity, but what is covered cannot be taken, nor what is full filled.

assert done(tree, PoseWorld(start))
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from learner.execution.entries import Found
from learner.execution.perception import query_of
from learner.execution.ticking import Status, Ticker
from learner.model import Node, ObjectShape, Pose, Scene, Tree
from learner.relations.answering import Answering, Seen

NEAR_M = 0.05
"""So near to the end-effector an object has to be to be gripped (CONTRACT, section 3)."""
CUBE_M = 0.05
CUBE = ObjectShape((CUBE_M, CUBE_M, CUBE_M), "cube")
BESIDE_M = 0.04
"""Two cubes whose origins are nearer than this, across and in height, would be in one another."""


class PoseWorld:
    """The leaves of a tree: every action runs for one tick and then happens at once.

    `solid` are cubes; what is not solid (a box, a mark on the table) covers nothing and is never full. `log` tells
    what was done and `faults` what failed.
    """

    def __init__(self, poses: Mapping[str, Pose], solid: str = "ABCDEFGH", base: str = "base") -> None:
        self.poses, self.solid, self.base = dict(poses), set(solid), base
        self.gripper, self.held = "open", "none"
        self.hand = Pose((0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0))
        self.grasp = Pose((0.0, 0.0, 0.0))
        self.under_way: Node | None = None
        self.log: list[str] = []
        self.faults: list[str] = []

    def check(self, node: Node) -> bool:
        if node.kind == "GripperIs":
            return self.gripper == node.port("state")
        if node.kind == "InGripper":
            return self.held == node.port("object")
        name = str(node.port("object"))
        return self.held != name and self._away(node, name) <= float(node.port("radius"))  # type: ignore[arg-type]

    def find(self, node: Node) -> Found | None:
        """What a query finds among the cubes; nobody knows a further grasp."""
        held = None if self.held == "none" else self.held
        known = Answering(Scene({name: CUBE for name in self.poses if name in self.solid}))
        return known.find(query_of(node), Seen(self.poses, self.hand, held, self.frame))

    def _away(self, node: Node, name: str) -> float:
        wanted = self.frame(str(node.port("frame"))).apply(node.port("position"))  # type: ignore[arg-type]
        here = self.poses[name].position
        return math.dist(here[:2], wanted[:2]) if node.kind == "ObjectRoughlyAt" else math.dist(here, wanted)

    def frame(self, name: str) -> Pose:
        return Pose((0.0, 0.0, 0.0)) if name == self.base else self.poses[name]

    def position(self, name: str, frame: str = "base") -> tuple[float, float, float]:
        """Where the object is in a frame [m]."""
        return (self.frame(frame).inverse() @ self.poses[name]).position

    def tick_action(self, node: Node) -> Status:
        if self.under_way is not node:
            self.under_way = node
            return Status.RUNNING
        self.under_way = None
        reason = getattr(self, f"_{node.kind.lower()}")(node)
        self.log.append(f"{node.kind} {dict(node.ports).get('object', dict(node.ports).get('state'))}")
        if reason:
            self.faults.append(f"{self.log[-1]}: {reason}")
        return Status.FAILURE if reason else Status.SUCCESS

    def halt_action(self, node: Node) -> None:
        if self.under_way is node:
            self.under_way = None

    def _move(self, node: Node) -> None:
        pose = Pose(node.port("position"), node.port("orientation"))  # type: ignore[arg-type]
        self.hand = self.frame(str(node.port("frame"))) @ pose
        if self.held != "none":
            self.poses[self.held] = self.hand @ self.grasp

    def _pick(self, node: Node) -> str | None:
        if self.gripper == "closed":
            return "the gripper is closed"
        self._move(node)
        self.gripper = "closed"
        distances = {name: math.dist(pose.position, self.hand.position) for name, pose in self.poses.items()}
        nearest = min(sorted(distances), key=lambda name: distances[name])
        if distances[nearest] > NEAR_M or self._covered(nearest):
            return f"{nearest} cannot be gripped"
        self.held = nearest
        self.grasp = self.hand.inverse() @ self.poses[nearest]
        return None if nearest == node.port("object") else f"{nearest} was gripped"

    def _covered(self, name: str) -> bool:
        offsets = (self._offset(other, name) for other in self.solid & set(self.poses) - {name})
        return any(math.hypot(x, y) < BESIDE_M and CUBE_M / 2 < z < 1.5 * CUBE_M for x, y, z in offsets)

    def _within(self, name: str, other: str) -> bool:
        x, y, z = self._offset(name, other)
        return math.hypot(x, y) < BESIDE_M and abs(z) < BESIDE_M

    def _offset(self, name: str, other: str) -> tuple[float, float, float]:
        x, y, z = (a - b for a, b in zip(self.poses[name].position, self.poses[other].position, strict=True))
        return (x, y, z)

    def _place(self, node: Node) -> str | None:
        name = str(node.port("object"))
        if self.held != name:
            return f"{self.held} is held"
        self._move(node)
        others = self.solid & set(self.poses) - {name}
        hit = [other for other in sorted(others) if self._within(name, other)]
        if hit and name in self.solid:
            return f"it would hit {hit[0]}"
        self.gripper, self.held = "open", "none"
        return None

    _drop = _place

    def _setgripper(self, node: Node) -> str | None:
        self.gripper = str(node.port("state"))
        self.held = "none" if self.gripper == "open" else self.held
        return None


def run(tree: Tree, world: PoseWorld, ticks: int = 400, until: Callable[[PoseWorld], bool] = lambda _: False) -> Status:
    """Tick until the tree succeeds at a tick in which no action ended, or the ticks are used up; the last status."""
    ticker = Ticker(tree.flattened(), world)
    status = Status.RUNNING
    for _ in range(ticks):
        before = len(world.log)
        status = ticker.tick()
        if (status is Status.SUCCESS and len(world.log) == before) or until(world):
            break
    return status


def done(tree: Tree, world: PoseWorld) -> bool:
    """Whether the tree comes to its end without a single action that failed."""
    return run(tree, world) is Status.SUCCESS and not world.faults
