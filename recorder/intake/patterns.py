"""Which of a cell's keys are recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import zenoh

from recorder.errors import RecorderError
from recorder.wire import ESSENTIAL


@dataclass(frozen=True)
class Patterns:
    """Which topics are recorded: those that a Zenoh key expression includes and none excludes.

    What learning needs, /poses, /gripper and /action, is recorded whatever the patterns say.
    """

    include: Sequence[str] = ()
    exclude: Sequence[str] = ()

    def __post_init__(self) -> None:
        for pattern in (*self.include, *self.exclude):
            try:
                zenoh.KeyExpr(pattern.strip("/"))
            except zenoh.ZError as error:
                raise RecorderError(f"{pattern!r} is no pattern of keys; write camera/* or **/image") from error

    def admit(self, topic: str) -> bool:
        """Whether a topic is recorded."""
        if topic in ESSENTIAL:
            return True
        included = not self.include or any(_matches(pattern, topic) for pattern in self.include)
        return included and not any(_matches(pattern, topic) for pattern in self.exclude)


def _matches(pattern: str, topic: str) -> bool:
    return zenoh.KeyExpr(pattern.strip("/")).includes(topic.strip("/"))
