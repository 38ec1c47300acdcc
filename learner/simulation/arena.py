"""What a world has to offer so that a tree can be run in it, disturbed, and judged by the truth.

Two worlds do: `learner.simulation.kinematic_world.KinematicWorld` (no dynamics, thousands of runs) and
`learner.simulation.physical_world.PhysicalWorld` (PyBullet with the arm, about a second a run).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from learner.execution.ticking import Leaves
from learner.model.frame import at_start
from learner.model.pose import Vector
from learner.model.upright import Spot, spot_of
from learner.simulation.gravity import Body, Table
from learner.simulation.kinematic_world import Attempt, Faults


class Truth(Protocol):
    """Where everything really is. Lengths [m]."""

    @property
    def bodies(self) -> Mapping[str, Body]:
        """What there is."""
        ...

    @property
    def held(self) -> str | None:
        """The object in the gripper."""
        ...

    def spot(self, name: str) -> Spot:
        """Where an object, a frame or the base is."""
        ...


@dataclass(frozen=True)
class Aftermath:
    """The truth of a world as a run left it, and what was done there: a value, while the world itself may be gone."""

    bodies: Mapping[str, Body]
    spots: Mapping[str, Spot]
    held: str | None
    attempts: Sequence[Attempt]
    faults: Faults

    @staticmethod
    def of(world: Arena) -> Aftermath:
        """How a world is now."""
        begun = map(at_start, world.bodies)
        spots = {name: world.spot(name) for name in (*world.bodies, *begun, world.base_frame)}
        return Aftermath(world.bodies, spots, world.held, tuple(world.attempts), world.faults)

    def spot(self, name: str) -> Spot:
        """Where an object, a frame or the base was."""
        return self.spots.get(name) or spot_of(name, self.spots)


class Arena(Leaves, Truth, Protocol):
    """A world that is ticked (`Leaves`), lives by `step`, and tells the truth. Lengths [m].

    `lay`, `carry` and `take_away` are a human's hands; `remember` and `recall` take back what they did, as long as
    the world was not stepped in between.
    """

    @property
    def base_frame(self) -> str:
        """The name of the base."""
        ...

    @property
    def table(self) -> Table:
        """Where everything really stands now; to be read."""
        ...

    @property
    def attempts(self) -> list[Attempt]:
        """The actions so far."""
        ...

    @property
    def faults(self) -> Faults:
        """What went wrong so far."""
        ...

    @property
    def steps(self) -> int:
        """How many periods of 0.1 s have passed."""
        ...

    def step(self) -> None:
        """Let 0.1 s pass."""
        ...

    def reaches(self, position: Vector) -> bool:
        """Whether the arm can bring its fingertips there."""
        ...

    def lay(self, name: str, spot: Spot) -> None:
        """Put an object that is not held onto whatever lies under `spot` (its z unused); what stood on it falls."""
        ...

    def carry(self, name: str, spot: Spot) -> None:
        """Move an object with all that stands on it."""
        ...

    def take_away(self, spot: Spot) -> None:
        """Pull the held object out of the fingers, which stay closed, and lay it at `spot`."""
        ...

    def remember(self) -> Any:
        """What `recall` needs."""
        ...

    def recall(self, memory: Any) -> None:
        """Let everything stand, and be held, as it was at `remember`."""
        ...

    def hand_is_clear(self) -> bool:
        """Whether nothing was put into the arm since the last step."""
        ...
