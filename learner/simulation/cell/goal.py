"""The goal of a scenario, looked at by the world's truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from learner.model import Pose
from learner.simulation.scenarios import Scenario

LOOK_S: Final = 1 / 30
"""How often the goal is looked at."""


class Goal:
    """Whether a scenario's goal holds, and since when [s of the world]."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self.reached, self._since_s = False, 0.0

    def forget(self) -> None:
        """Begin anew."""
        self.reached, self._since_s = False, 0.0

    def look(self, time_s: float, held: str | None, poses: Mapping[str, Pose]) -> None:
        """Look at everything; with something in the gripper the goal does not hold."""
        reached = held is None and self._scenario.reached(poses)
        if reached and not self.reached:
            self._since_s = time_s
        self.reached = reached

    def held_s(self, time_s: float) -> float:
        """For how long [s] it has held; 0 where it does not."""
        return time_s - self._since_s if self.reached else 0.0
