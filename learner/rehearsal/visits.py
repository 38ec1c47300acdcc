"""The stops that a run comes to, by the world's truth."""

from __future__ import annotations

from learner.rehearsal.goal import Goal, Relation, holds
from learner.simulation.arena import Arena


class Visits:
    """What is left of the stops of a goal; what lies at its end when the run begins needs none."""

    def __init__(self, goal: Goal, world: Arena) -> None:
        self.left: list[list[Relation]] = [list(stops) for end, stops in goal.stops if not holds(end, world)]

    def look(self, world: Arena) -> None:
        """Take note of where everything is now. Of the stops of one object each is left until those before it are."""
        for stops in self.left:
            if stops and holds(stops[0], world):
                stops.pop(0)

    @property
    def missed(self) -> bool:
        """Whether an object has not come to all its stops yet."""
        return any(self.left)
