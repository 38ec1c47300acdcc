"""The table and the things on it, as bodies of the physics engine."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Final, Literal

from learner.errors import LearnerError
from learner.model import Pose
from learner.model.pose import Vector
from learner.simulation.cell.engine import Engine
from learner.simulation.scenarios import Body

TABLE: Final = "the table"
BELOW_M: Final = 10.0
"""So far below the table [m], and below each other, is what somebody took away."""
STILL_M_PER_S: Final = 0.01
STILL_RAD_PER_S: Final = 0.1
"""What moves more slowly than this stands still."""


class UnknownObjectError(LearnerError):
    """An object or frame that the cell does not have."""

    def __init__(self, kind: Literal["object", "frame"], name: object, known: tuple[str, ...]) -> None:
        super().__init__(f"no {kind} {str(name)[:80]!r} in this cell; it has {', '.join(known)}")


class Bodies:
    """Everything on the table by its name, `kinds` telling its shape and mass; its poses are the true ones."""

    def __init__(self, engine: Engine, kinds: Mapping[str, Body]) -> None:
        self.kinds = dict(kinds)
        self._engine = engine
        self._ids = {name: self._add(body) for name, body in sorted(kinds.items())}
        self._names = {body: name for name, body in self._ids.items()}
        self._away: set[str] = set()

    @property
    def names(self) -> tuple[str, ...]:
        """All names, sorted."""
        return tuple(self._ids)

    def id(self, name: str) -> int:
        """The engine's number of a body. Raises UnknownObjectError."""
        if name not in self._ids:
            raise UnknownObjectError("object", name, self.names)
        return self._ids[name]

    def name(self, body: int) -> str:
        """The name of a body by the engine's number; TABLE for what is none of them."""
        return self._names.get(body, TABLE)

    def pose(self, name: str) -> Pose:
        """The pose of an object in the base. Raises UnknownObjectError."""
        position, quaternion_xyzw = self._engine.getBasePositionAndOrientation(self.id(name))
        return Pose.of(position, quaternion_xyzw)

    @property
    def away(self) -> frozenset[str]:
        """What somebody took off the table."""
        return frozenset(self._away)

    def take_away(self, name: str) -> None:
        """Take an object off the table, until it is put somewhere. Raises UnknownObjectError."""
        turn = self.pose(name).quaternion_xyzw
        # Each in a place of its own: no goal holds between two of them.
        self.put(name, Pose((0.0, 0.0, -BELOW_M * (1 + self.names.index(name))), turn))
        self._engine.changeDynamics(self._ids[name], -1, mass=0.0)
        self._away.add(name)

    def position(self, name: str) -> Vector:
        """The position of an object in the base [m]; sooner than its pose."""
        position: Vector = self._engine.getBasePositionAndOrientation(self._ids[name])[0]
        return position

    def put(self, name: str, pose: Pose) -> None:
        """Let an object stand at a pose at once, without motion."""
        if name in self._away:
            self._away.remove(name)
            self._engine.changeDynamics(self._ids[name], -1, mass=self.kinds[name].mass_kg)
        self._engine.resetBasePositionAndOrientation(self._ids[name], pose.position, pose.quaternion_xyzw)
        self._engine.resetBaseVelocity(self._ids[name], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def moves(self, name: str) -> bool:
        """Whether an object is in motion."""
        linear, angular = self._engine.getBaseVelocity(self._ids[name])
        return math.hypot(*linear) > STILL_M_PER_S or math.hypot(*angular) > STILL_RAD_PER_S

    def sleep(self, names: Iterable[str]) -> None:
        """Let objects that lie still cost nothing: they stay where they are until something that moves touches them."""
        asleep = self._engine.ACTIVATION_STATE_SLEEP | self._engine.ACTIVATION_STATE_ENABLE_SLEEPING
        for name in names:
            self._engine.changeDynamics(self._ids[name], -1, activationState=asleep)

    def wake(self) -> None:
        """Let no object sleep."""
        awake = self._engine.ACTIVATION_STATE_WAKE_UP | self._engine.ACTIVATION_STATE_DISABLE_SLEEPING
        for body in self._ids.values():
            self._engine.changeDynamics(body, -1, activationState=awake)

    def content(self, name: str) -> list[str]:
        """What lies within or upon an object that is wider than a cube. Raises UnknownObjectError."""
        frame = self.pose(name).inverse()
        length, width, height = self.kinds[name].size_m
        inside = {other: frame.apply(self.pose(other).position) for other in self.names if other != name}
        return [
            other
            for other, (x, y, z) in inside.items()
            if not self.kinds[name].graspable and abs(x) < length / 2 and abs(y) < width / 2 and -height / 2 < z < 0.3
        ]

    def _add(self, body: Body) -> int:
        slabs = _slabs(body)
        shape = self._engine.createCollisionShapeArray(
            shapeTypes=[self._engine.GEOM_BOX] * len(slabs),
            halfExtents=[[side / 2 for side in size] for size, _ in slabs],
            collisionFramePositions=[list(center) for _, center in slabs],
        )
        number: int = self._engine.createMultiBody(body.mass_kg, shape)
        self._engine.changeDynamics(number, -1, lateralFriction=0.8, rollingFriction=1e-4, spinningFriction=1e-3)
        return number


def add_table(engine: Engine) -> int:
    """Put the table there; the engine's number of it."""
    half = (0.8, 1.0, 0.05)
    shape = engine.createCollisionShape(engine.GEOM_BOX, halfExtents=half)
    table: int = engine.createMultiBody(0.0, shape, basePosition=(0.5, 0.0, -half[2]))
    engine.changeDynamics(table, -1, lateralFriction=0.8)
    return table


def upright(cube: Pose) -> Pose:
    """The pose of a cube whose sides look the same, with its z axis on the side that is up: the same if it stands."""
    x, y, z, w = cube.quaternion_xyzw
    ups = (
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )  # of its axes: the last row of the rotation
    side = max(range(3), key=lambda axis: abs(ups[axis]))
    if side == 2 and ups[2] > 0:
        return cube
    half = math.pi / 2 if side == 2 else math.copysign(math.pi / 4, ups[side])
    about = {0: (0.0, math.sin(half), 0.0), 1: (-math.sin(half), 0.0, 0.0), 2: (math.sin(half), 0.0, 0.0)}[side]
    return cube @ Pose((0.0, 0.0, 0.0), (*about, math.cos(half)))


def _slabs(body: Body) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """The blocks (size, center) [m] that a body is made of: one, or a floor and four walls."""
    length, width, height = body.size_m
    if body.wall_m is None:
        return [(body.size_m, (0.0, 0.0, 0.0))]
    wall = body.wall_m
    walls = [((wall, width, height), (side * (length - wall) / 2, 0.0, 0.0)) for side in (-1, 1)]
    walls += [((length, wall, height), (0.0, side * (width - wall) / 2, 0.0)) for side in (-1, 1)]
    return [((length, width, wall), (0.0, 0.0, (wall - height) / 2)), *walls]
