"""Where what is in the way is put aside: free spots on the table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from learner.inference.targets import Target
from learner.model import Definition, GripperIs, InGripper, Node, ObjectRoughlyAt, Place, Pose, SetGripper
from learner.model.condition import DROP_RADIUS_M
from learner.model.pose import Array
from learner.model.tree import fallback, first_of, guarded, leaf, negated, sequence, subtree
from learner.model.vocabulary import RECOVERY_PREFIX
from learner.planning.obstacles import Obstacles
from learner.planning.rounding import rounded_pose, rounded_vector

PUT_DOWN: Final = f"{RECOVERY_PREFIX}PutDown"
SPOT_FREE: Final = f"{RECOVERY_PREFIX}SpotIsFree"


def put_down() -> Node:
    """The use of the SubTree that empties and opens the gripper: what it holds is set down on the first free spot."""
    return subtree(PUT_DOWN)


@dataclass(frozen=True, eq=False)
class Spots:
    """Spots in the base where objects have lain and the robot has reached."""

    obstacles: Obstacles
    targets: Sequence[Target]

    @property
    def definitions(self) -> list[Definition]:
        """The SubTrees that `put_down` uses."""
        placed = first_of([self._put_on(spot) for spot in self._chosen()])
        body = fallback(leaf(GripperIs("open")), placed, leaf(SetGripper("open")))
        return [Definition(SPOT_FREE, self._spot_is_free(), ("position",)), Definition(PUT_DOWN, body)]

    def _put_on(self, spot: Array) -> Node:
        """Places what is held on a spot (2,), if that is free."""
        places = [self._place(name, spot) for name in sorted(self.obstacles.picks)]
        put = first_of([guarded(InGripper(place.object), leaf(place)) for place in places])
        return sequence(subtree(SPOT_FREE, position=rounded_vector((spot[0], spot[1], 0.0))), put, reactive=False)

    def _place(self, name: str, spot: Array) -> Place:
        pose = self._pose_on_table(name, spot)
        hand = rounded_pose(pose @ self.obstacles.actions.grasp_of(self.obstacles.picks[name]))
        return Place(name, self.obstacles.base, hand.position, hand.quaternion_xyzw, rounded_vector(pose.position))

    def _pose_on_table(self, name: str, spot: Array) -> Pose:
        """The pose of an object that stands on the table, a little raised, oriented as it was first seen."""
        poses = [d.first_seen[name] for d in self.obstacles.demonstrations if name in d.first_seen]
        lowest = min(poses, key=lambda pose: pose.position[2])
        height_m = min(self.obstacles.first_heights_m(name)) + self.obstacles.parameters.raised_m
        return Pose.of((spot[0], spot[1], height_m), lowest.quaternion_xyzw)

    def _chosen(self) -> list[Array]:
        """Not the outermost, so that what belongs beside what is put there stays in reach; far from the places that
        the task itself needs, and from one another. Each (2,), in the base.
        """
        inside, count = self._inside(), self.obstacles.parameters.spots
        placements = self.obstacles.actions.placements
        places = [np.array(placements[t].rest[:2]) for t in self.targets if t.frame == self.obstacles.base]
        chosen: list[Array] = [] if places else [inside[0]]
        while len(chosen) < min(count, len(inside)):
            away = np.linalg.norm(inside[:, None] - np.array([*places, *chosen])[None], axis=2).min(axis=1)
            chosen.append(inside[int(np.argmax(away))])
        return chosen

    def _inside(self) -> Array:
        """Where obstacles were first seen (n, 2), from the middle outwards, without the outermost."""
        numbers = self.obstacles.parameters
        begins = [d.first_seen for d in self.obstacles.demonstrations]
        seen = np.array(
            [pose.position[:2] for begin in begins for name, pose in begin.items() if name in self.obstacles.picks]
        )
        outside = np.linalg.norm(seen - np.median(seen, axis=0), axis=1)
        count = max(numbers.spots, round(numbers.inner * len(seen)))
        return np.asarray(seen[np.argsort(outside, kind="stable")[:count]])

    def _spot_is_free(self) -> Node:
        """No object is near the spot at the port `position`."""
        names = sorted({name for d in self.obstacles.demonstrations for name in d.objects})
        return sequence(*(negated(self._near(name, "position")) for name in names))

    def _near(self, name: str, port: str) -> Node:
        """Whether an object is near the position at a port."""
        template = leaf(ObjectRoughlyAt(name, self.obstacles.base, (0.0, 0.0, 0.0), DROP_RADIUS_M))
        return replace(template, ports=tuple(sorted({**dict(template.ports), "position": f"{{{port}}}"}.items())))
