"""Why an action failed in a simulated cell, as a value; `str` of it is the sentence that a cell answers with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from learner.model.pose import Vector

Kind = Literal["contact", "missed", "not held", "lost", "out of reach", "gripper closed", "random", "other"]


@dataclass(frozen=True)
class Failure:
    """What kind of failure, of the action's `object`, and `with_` what it met, closed on or held instead.

    Where exactly the hand was does not tell failures apart: neither `left_m`, the way to the target that was left at a
    contact [m], nor `at`, the point in the base that is out of reach [m]. `said` is the sentence of an `other` kind.
    """

    kind: Kind
    object: str = ""
    with_: str | None = None
    left_m: float | None = field(default=None, compare=False)
    at: Vector | None = field(default=None, compare=False)
    said: str = ""

    def __str__(self) -> str:
        match self.kind:
            case "contact":
                return f"contact with {self.with_}{self._left}"
            case "missed":
                return f"{self.object} is not held: the fingers closed on {self.with_ or 'nothing'}"
            case "not held":
                return f"{self.object} is not held: the gripper holds {self.with_ or 'nothing'}"
            case "lost":
                return f"{self.object} was lost on the way"
            case "out of reach":
                return f"the pose is out of reach{self._where}"
            case "gripper closed":
                return "the gripper is closed already"
            case "random":
                return "the skill failed"
            case "other":
                return self.said

    @property
    def _left(self) -> str:
        return "" if self.left_m is None else f" {self.left_m * 100:.1f} cm before the target"

    @property
    def _where(self) -> str:
        return "" if self.at is None else ": {:.3f}, {:.3f}, {:.3f} m in the base".format(*self.at)
