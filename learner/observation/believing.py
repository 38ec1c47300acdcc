"""What a cell could believe of a pick, by the rule by which it believes that something is held (InGripper)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from learner.model import Pose, Scene
from learner.model.holding import NEAR_M, Sizes, grasped, reaches

_FAR: Final = (
    "at the pick {name} is {reach} from the end-effector ({by}); a cell believes that it holds what is within {near}, "
    "so InGripper of {name} could never hold"
)
_NEARER: Final = (
    "at the pick {other} is nearer to the end-effector than {name} ({by}); a cell would believe that it holds {other}"
)


def unbelievable(end_effector: Pose, objects: Mapping[str, Pose], name: str, scene: Scene | None) -> str | None:
    """Why no cell could believe that it holds `name` after a pick here; None if it can.

    Poses are in the base, those of `objects` at the press; `name` is one of them.
    """
    sizes: Sizes = {} if scene is None else scene.sizes
    grasps = reaches(_sighting(end_effector), {each: _sighting(pose) for each, pose in objects.items()}, sizes)
    mine = next(grasp for grasp in grasps if grasp.object == name)
    by = "by the sizes of the scene" if name in sizes else "by its origin, since the scene tells no size"
    if mine.reach_m > NEAR_M:
        return _FAR.format(name=name, reach=_cm(mine.reach_m), by=by, near=_cm(NEAR_M))
    return None if grasps[0] is mine else _NEARER.format(name=name, other=grasps[0].object, by=by)


def in_reach(end_effector: Pose, name: str, pose: Pose, scene: Scene | None) -> bool:
    """Whether an object that is seen at `pose` can be in the gripper at all."""
    return grasped(_sighting(end_effector), {name: _sighting(pose)}, {} if scene is None else scene.sizes) is not None


def _sighting(pose: Pose) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    return pose.position, pose.quaternion_xyzw


def _cm(distance_m: float) -> str:
    return f"{100 * distance_m:.0f} cm" if distance_m >= 0.1 else f"{100 * distance_m:.3g} cm"
