"""Whether anything on the table moves; what does not, sleeps."""

from __future__ import annotations

from typing import Final

from learner.simulation.cell.bodies import Bodies

LOOK_STEPS: Final = 4
"""How often it is looked whether anything moves."""
STILL_STEPS: Final = 24
"""What has not moved for so long is at rest."""


class Rest:
    """For how long nothing has moved but the arm and what it holds."""

    def __init__(self, bodies: Bodies) -> None:
        self._bodies = bodies
        self._still_steps = 0

    def __bool__(self) -> bool:
        """Whether nothing has moved for a while."""
        return self._still_steps >= STILL_STEPS

    def look(self, held: str | None) -> None:
        """Look again, LOOK_STEPS after the last time; what comes to rest so falls asleep."""
        rested, others = bool(self), [name for name in self._bodies.names if name != held]
        self._still_steps = 0 if any(map(self._bodies.moves, others)) else self._still_steps + LOOK_STEPS
        if self and not rested:
            self._bodies.sleep(others)

    def end(self) -> None:
        """Something was put, grasped or released: it may move now, and all that it carried."""
        self._still_steps = 0
        self._bodies.wake()
