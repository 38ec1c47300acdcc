"""A physics engine of its own: PyBullet, without its window."""

from __future__ import annotations

import functools
from typing import Any, Final

import pybullet

PERIOD_S: Final = 1 / 240


class Engine:
    """PyBullet's functions, called upon one engine, with gravity and steps of PERIOD_S.

    Not pybullet_utils' client: that one writes on standard output.
    """

    def __init__(self) -> None:
        self._number: int = pybullet.connect(pybullet.DIRECT)
        self.setTimeStep(PERIOD_S)
        self.setGravity(0.0, 0.0, -9.81)

    def __getattr__(self, name: str) -> Any:
        found = getattr(pybullet, name)
        return functools.partial(found, physicsClientId=self._number) if callable(found) else found
