"""Open or closed: what the messages of a gripper's topic say, whichever of the usual types they have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from learner.model.condition import GripperState

BOOL: Final = "std_msgs/msg/Bool"
JOINTS: Final = "sensor_msgs/msg/JointState"
NUMBERS: Final = ("std_msgs/msg/Float64", "std_msgs/msg/Float32")
TYPES: Final = (BOOL, JOINTS, *NUMBERS)


class NoGripperError(Exception):
    """Messages that do not tell whether a gripper is open: a sentence."""


@dataclass(frozen=True)
class Meaning:
    """Which number of a message counts (`joint`), and on which side of the `threshold` the gripper is closed.

    Without a threshold the middle between the least and the greatest number is one; without a side it is closed below,
    as a width is, and a bool is closed where it is true, unless its topic is named for being open.
    """

    joint: str | None = None
    threshold: float | None = None
    closed: Literal["below", "above"] | None = None


def number_of(message: Any, kind: str, meaning: Meaning) -> float:
    """The number that a message tells. Raises NoGripperError."""
    if kind != JOINTS:
        return float(message.data)
    names, positions = list(message.name), list(message.position)
    if meaning.joint is None and len(positions) == 1:
        return float(positions[0])
    if meaning.joint is None:
        raise NoGripperError(f"its joints are {', '.join(names) or 'unnamed'}; name the one to go by (--gripper-joint)")
    if meaning.joint not in names or names.index(meaning.joint) >= len(positions):
        raise NoGripperError(f"it has no joint {meaning.joint!r}; its joints are {', '.join(names) or 'unnamed'}")
    return float(positions[names.index(meaning.joint)])


def states_of(numbers: Sequence[float], topic: str, kind: str, meaning: Meaning) -> list[GripperState]:
    """What each number says. Raises NoGripperError where there are none, or they never change without a threshold."""
    if not numbers:
        raise NoGripperError("it has no messages")
    is_bool = kind == BOOL
    least, greatest = min(numbers), max(numbers)
    threshold = (least + greatest) / 2 if meaning.threshold is None else meaning.threshold
    if is_bool and meaning.threshold is None:
        threshold = 0.5
    elif least == greatest and meaning.threshold is None:
        raise NoGripperError(f"it says {least:g} all the time; give the number between open and closed "
                             "(--gripper-threshold)")  # fmt: skip
    side = meaning.closed or ("above" if is_bool and "open" not in topic.lower() else "below")
    return ["closed" if (number < threshold) == (side == "below") else "open" for number in numbers]
