"""The skills of the contract, section 3, as activities that can be stopped between any two physics steps.

Pick and Place go straight up to the height of travel, around to above the target, and straight down to it; after
closing or opening they retreat straight up. Contact up to SLACK_M before the target counts as arrival, of what is held
with anything and of the empty hand with the table: the support is where hand noise and camera noise let it be. The
fingers stand no wider apart than what they take or leave needs. A skill that ends early leaves them as they are.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Final, Literal

from learner.model import Pose
from learner.model.condition import GripperState
from learner.simulation.cell.arm_kinematics import inverse
from learner.simulation.cell.bodies import TABLE, UnknownObjectError
from learner.simulation.cell.motion import Around, Straight, Travel, travel, wait
from learner.simulation.cell.physics import World
from learner.simulation.failure import Failure

TRAVEL_HEIGHT_M: Final = 0.30
"""Of `tool0`: what is held clears a tower of four."""
APPROACH_M: Final = 0.10
"""Height of the approach over targets near or above the height of travel."""
SLACK_M: Final = 0.015
TRAVEL_M_PER_S: Final = 0.6
DOWN_M_PER_S: Final = 0.25
LIFT_M_PER_S: Final = 0.4
FINGERS_STILL_M_PER_S: Final = 2e-3
FINGERS_PATIENCE_S: Final = 1.5


@dataclass(frozen=True)
class SkillResult:
    """How a skill ended: well, unless there is a `failure`."""

    failure: Failure | None = None

    @property
    def status(self) -> Literal["success", "failure"]:
        """As the contract's skills answer."""
        return "success" if self.failure is None else "failure"

    @property
    def reason(self) -> str | None:
        """The sentence that goes with a failure."""
        return None if self.failure is None else str(self.failure)


SUCCESS: Final = SkillResult()
Skill = Generator[None, None, SkillResult]


def pick(world: World, name: str, frame: str, tool_in_frame: Pose) -> Skill:
    """Move to the pose in the frame, close, lift. Fails if the gripper is closed at its start, or on contact, or if
    `name` is not held at its end. Raises UnknownObjectError at its first step.

    Fingers that closed on nothing are lifted too: only then is it seen that what is between them does not follow.
    """
    _check_object(world, name)
    target = world.frame_in_base(frame) @ tool_in_frame
    if world.gripper.state == "closed":
        return SkillResult(Failure("gripper closed", name))
    world.gripper.make_ready(name)
    failure = yield from approach(world, target, ignored=name)
    if failure is not None:
        return SkillResult(failure)
    yield from close_gripper(world)
    grasped = world.held
    if grasped in (None, name):
        yield from lift(world)
    if grasped != name:
        return SkillResult(Failure("missed", name, grasped))
    return SUCCESS if world.held == name else SkillResult(Failure("lost", name))


def place(world: World, name: str, frame: str, tool_in_frame: Pose) -> Skill:
    """Move to the pose in the frame, open, retreat: Place and Drop. Fails if `name` is not held when it would open,
    or on contact, then still holding it. Raises UnknownObjectError at its first step.
    """
    _check_object(world, name)
    target = world.frame_in_base(frame) @ tool_in_frame
    if world.held != name:
        yield from lift(world)
        return SkillResult(Failure("not held", name, world.held))
    failure = yield from approach(world, target, held=name)
    if failure is not None:
        return SkillResult(failure)
    yield from open_gripper(world)
    yield from lift(world)
    return SUCCESS


def set_gripper(world: World, state: GripperState) -> Skill:
    """Open or close where the hand is."""
    yield from (open_gripper(world) if state == "open" else close_gripper(world))
    return SUCCESS


def move(world: World, target: Pose) -> Skill:
    """Bring the hand to a pose in the base, as an operator who leads it: up, around, down."""
    return SkillResult((yield from approach(world, target, held=world.held)))


def approach(world: World, target: Pose, ignored: str | None = None, held: str | None = None) -> Travel:
    """Up, around and down to a pose of `tool0` in the base; the failure where it ends early.

    `ignored` may brush the fingers from the side; `held` has to stay in the gripper on the way.
    """
    above = _raised(target, max(TRAVEL_HEIGHT_M, target.position[2] + APPROACH_M))
    if inverse(target) is None or inverse(above) is None:
        return Failure("out of reach", at=target.position)

    def watch(left_m: float) -> Failure | None:
        if held is not None and world.held != held:
            return Failure("lost", held)
        obstacle = world.obstacle(ignored)
        return None if obstacle is None else Failure("contact", with_=obstacle, left_m=left_m)

    yield from lift(world, above.position[2])
    failure = yield from travel(world, Around(world.arm.tool_pose, above), TRAVEL_M_PER_S, watch)
    if failure is not None:
        return failure
    failure = yield from travel(world, Straight(above, target), DOWN_M_PER_S, watch)
    return None if failure is not None and _has_arrived(world, failure) else failure


def _has_arrived(world: World, failure: Failure) -> bool:
    """Whether the hand met on its way down what it was to meet."""
    near = failure.left_m is not None and failure.left_m <= SLACK_M
    return near and (world.held is not None or failure.with_ == TABLE)


def lift(world: World, height_m: float = TRAVEL_HEIGHT_M) -> Travel:
    """Straight up to a height of `tool0`; nothing to do where it is there or higher.

    Contact does not stop it: what the held object stands on or leans against touches it at first.
    """
    here = world.arm.tool_pose
    if here.position[2] >= height_m - 1e-3:
        return None
    return (yield from travel(world, Straight(here, _raised(here, height_m)), LIFT_M_PER_S, lambda left_m: None))


def close_gripper(world: World) -> Generator[None, None, None]:
    """Close until the fingers stand still; what they grasped well is held."""
    if world.gripper.state == "closed":
        return
    grasped = world.gripper.close()
    yield from _until_fingers_stand(world)
    world.gripper.finish_closing(grasped)


def open_gripper(world: World) -> Generator[None, None, None]:
    """Release what is held, and open until the fingers stand still."""
    world.gripper.open()
    yield from _until_fingers_stand(world)


def _until_fingers_stand(world: World) -> Generator[None, None, None]:
    yield from wait(0.1)
    for _ in wait(FINGERS_PATIENCE_S):
        if world.arm.finger_speed_m_per_s < FINGERS_STILL_M_PER_S:
            return
        yield


def _raised(pose: Pose, height_m: float) -> Pose:
    x, y, _ = pose.position
    return Pose((x, y, height_m), pose.quaternion_xyzw)


def _check_object(world: World, name: str) -> None:
    if name not in world.objects:
        raise UnknownObjectError("object", name, world.objects)
