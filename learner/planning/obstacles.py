"""What may lie in the way: how each such object stands, where it was first seen, and how it is grasped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from learner.model import Demonstration, ObjectShape, Pick, Pose
from learner.model.names import distinct_identifiers
from learner.model.pose import Array, conjugate, rotate
from learner.planning.actions import LearnedActions
from learner.planning.grasps import Upright, borrowed_grasp, quarter_turned
from learner.planning.parameters import RecoveryParameters
from learner.planning.rounding import rounded_pose
from learner.relations.grasping import Grasp


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Every object that was picked, and with a scene every other one that a gripper can be thought to span."""

    demonstrations: Sequence[Demonstration]
    actions: LearnedActions

    @property
    def parameters(self) -> RecoveryParameters:
        return self.actions.parameters.recovery

    @property
    def base(self) -> str:
        """The base frame."""
        return self.demonstrations[0].base_frame

    @property
    def has_scene(self) -> bool:
        """Whether shapes are known; where not, objects are points."""
        return self.actions.scene is not None

    @property
    def shapes(self) -> Mapping[str, ObjectShape]:
        """The known shapes, of objects that are no obstacles too."""
        return self.actions.scene.objects if self.actions.scene else {}

    @cached_property
    def ids(self) -> Mapping[str, str]:
        """The name of each object, of the base and of each frame as a part of a SubTree's ID."""
        names = {name for d in self.demonstrations for name in (*d.objects, d.base_frame)}
        return distinct_identifiers(names | {target.frame for target in self.actions.placements})

    @cached_property
    def picks(self) -> Mapping[str, Pick]:
        """How to grasp each obstacle."""
        picks = {name: self.actions.pick(name) for name in self.actions.grasps if not self._is_fixed(name)}
        seen = {name for d in self.demonstrations for name in d.first_seen}
        uprights = {name: Upright(shape, self._up(name)) for name, shape in sorted(self.shapes.items()) if name in seen}
        for name in sorted(set(uprights) - set(picks)):
            grasp = borrowed_grasp(uprights[name], self.actions.grasps, uprights, self.actions.parameters.grasps)
            if grasp is not None and not self._is_fixed(name):
                picks[name] = _pick(name, grasp)
        return picks

    @cached_property
    def turned(self) -> Mapping[str, Sequence[Pose]]:
        """The further grasps of each obstacle: turned by a quarter, where its sides are alike or nobody showed which is
        grasped, then by a half, and by three quarters.
        """
        found = {}
        for name in self.picks.keys() & self.shapes.keys():
            own, up = self.actions.grasp_of(self.picks[name]), self.ups[name]
            quarter = quarter_turned(own, up)
            half = quarter_turned(quarter, up)
            square = self._guessed(name) or self.shapes[name].symmetry in ("cube", "vertical")
            found[name] = [rounded_pose(pose) for pose in ((quarter, half, quarter_turned(half, up)) if square else ())]
        return found

    @cached_property
    def grasps(self) -> tuple[Grasp, ...]:
        """Of each obstacle, in the order in which they are tried."""
        return tuple(
            Grasp(pose, object=name)
            for name, pick in sorted(self.picks.items())
            for pose in (self.actions.grasp_of(pick), *self.turned.get(name, ()))
        )

    def _is_fixed(self, name: str) -> bool:
        return name in self.shapes and self.shapes[name].fixed

    def _guessed(self, name: str) -> bool:
        """Whether nobody showed across which of two different sides an object is grasped."""
        within_m = self.actions.parameters.grasps.square_m
        return name not in self.actions.grasps and not self.upright(name).is_square(within_m)

    @cached_property
    def ups(self) -> Mapping[str, Array]:
        """For each obstacle the direction (3,), in its own frame, that points up in the base on average."""
        return {name: self._up(name) for name in self.picks}

    def _up(self, name: str) -> Array:
        poses = [d.first_seen[name] for d in self.demonstrations if name in d.first_seen]
        quaternions = np.array([pose.quaternion_xyzw for pose in poses])
        up = rotate(conjugate(quaternions), np.array([0.0, 0.0, 1.0])).mean(axis=0)
        norm = float(np.linalg.norm(up))
        return np.asarray(up / norm) if norm > self.parameters.upright else np.array([0.0, 0.0, 1.0])

    def up(self, name: str) -> Array:
        """The direction (3,), in the frame of an object that may be no obstacle, that points up in the base."""
        return self._up(name)

    def height_m(self, name: str) -> float:
        """How high an object of known shape is as it stands [m]."""
        return Upright(self.shapes[name], self._up(name)).height_m

    def upright(self, name: str) -> Upright:
        """An obstacle of known shape as it stands."""
        return Upright(self.shapes[name], self.ups[name])

    def first_heights_m(self, name: str) -> list[float]:
        """Heights [m] at which the object, or an obstacle of the same shape, was first seen."""
        shape = self.shapes.get(name)
        alike = [o for o in self.picks if o == name or (self.has_scene and self.shapes.get(o) == shape)]
        seen = [d.first_seen for d in self.demonstrations]
        return [poses[other].position[2] for poses in seen for other in alike if other in poses]


def _pick(name: str, grasp: Pose) -> Pick:
    hand = rounded_pose(grasp)
    return Pick(name, name, hand.position, hand.quaternion_xyzw)
