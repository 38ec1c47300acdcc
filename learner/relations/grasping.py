"""Which grasp of an object is tried: the first of those that are known, after each that failed the next."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from learner.model.pose import Pose, Vector
from learner.model.scene import ObjectShape, Scene

MOVED_M: Final = 0.02
"""An object that is this far from where a grasp of it failed has moved [m]: all grasps may be tried again."""


@dataclass(frozen=True)
class Grasp:
    """The end-effector's `pose` in the frame of an object at which to pick it: that object, one of its kind or size."""

    pose: Pose
    object: str | None = None
    kind: str | None = None
    size_m: Vector | None = None

    def fits(self, shape: ObjectShape) -> bool:
        """Whether it is one for the kind of an object, or for its size."""
        return (self.kind is not None and self.kind == shape.kind) or self.size_m == shape.size_m

    def to_data(self) -> dict[str, Any]:
        """The JSON of the manifest (CONTRACT, section 3, FindGrasp)."""
        of = {"object": self.object, "kind": self.kind, "size_m": self.size_m and list(self.size_m)}
        pose = {"position": list(self.pose.position), "orientation": list(self.pose.quaternion_xyzw)}
        return {**{name: value for name, value in of.items() if value}, **pose}

    @staticmethod
    def of_data(data: Mapping[str, Any]) -> Grasp:
        """The grasp of such JSON. Raises KeyError, TypeError, ValueError or ModelError for what is none."""
        size = data.get("size_m")
        pose = Pose.of(data["position"], data["orientation"])
        return Grasp(pose, data.get("object"), data.get("kind"), None if size is None else _size(size))


def _size(numbers: Sequence[float]) -> Vector:
    x, y, z = map(float, numbers)
    return x, y, z


class Grasping:
    """The grasps of a cell, and which of them failed where since the object last moved."""

    def __init__(self, grasps: Sequence[Grasp], scene: Scene) -> None:
        self.grasps, self.scene = grasps, scene
        self._failed: dict[str, tuple[Vector, list[Pose]]] = {}
        self._known: dict[str, list[Pose]] = {}

    def graspable(self, names: Iterable[str]) -> set[str]:
        """Those of some objects that somebody knows how to grasp; all, where nobody knows it of any."""
        return {name for name in names if not self.grasps or self.of(name)}

    def next(self, name: str, at: Pose) -> Pose | None:
        """The next grasp of an object that is at a pose in the base; None once all have failed there."""
        where, failed = self._failed.get(name, (at.position, []))
        if math.dist(where, at.position) > MOVED_M:
            del self._failed[name]
            failed = []
        return next((pose for pose in self.of(name) if pose not in failed), None)

    def failed(self, name: str, at: Pose, grasp: Pose) -> None:
        """A Pick of an object at a pose in the base has failed with a grasp."""
        _, poses = self._failed.setdefault(name, (at.position, []))
        poses.append(grasp)

    def of(self, name: str) -> list[Pose]:
        """Those of an object: its own, then those of its kind, then those of the nearest size."""
        if name not in self._known:
            self._known[name] = self._of(name)
        return self._known[name]

    def _of(self, name: str) -> list[Pose]:
        shape = self.scene.objects.get(name)
        own = [grasp.pose for grasp in self.grasps if grasp.object == name]
        kind = [grasp.pose for grasp in self.grasps if shape and shape.kind and grasp.kind == shape.kind]
        sized = [grasp for grasp in self.grasps if grasp.size_m is not None and shape]
        away = {grasp: math.dist(sorted(grasp.size_m or ()), sorted(shape.size_m)) for grasp in sized if shape}
        nearest = [grasp.pose for grasp in sized if away[grasp] == min(away.values())]
        return list(dict.fromkeys([*own, *kind, *nearest]))
