"""What is known of the shapes on the table: the scene of CONTRACT, section 2, and its JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

from learner.errors import NameRefusedError
from learner.model.names import check_name
from learner.model.pose import Vector

Symmetry = Literal["none", "cube", "box", "vertical"]
Range = tuple[float, float]


@dataclass(frozen=True)
class ObjectShape:
    """Size [m] along the object's own axes, and which turns of it look the same (CONTRACT, section 2).

    Objects of one `kind` can stand for one another; in one that is `open` things lie, not upon it; one that is `fixed`
    is never picked.
    """

    size_m: Vector
    symmetry: Symmetry = "none"
    kind: str | None = None
    open: bool = False
    fixed: bool = False

    def to_data(self) -> dict[str, Any]:
        """The JSON of CONTRACT, section 2."""
        said = {"kind": self.kind, "open": self.open, "fixed": self.fixed}
        told = {name: value for name, value in said.items() if value}
        return {"size_m": list(self.size_m), "symmetry": self.symmetry, **told}

    @staticmethod
    def of_data(name: str, data: Mapping[str, Any]) -> ObjectShape:
        """The shape of the object `name`. Raises ValueError, TypeError or KeyError for what is no shape."""
        size = tuple(_finite(number) for number in data["size_m"])
        symmetry, kind = data.get("symmetry", "none"), data.get("kind")
        if len(size) != 3 or min(size) <= 0:
            raise ValueError(f"the size of {name} is not three positive lengths")
        if symmetry not in get_args(Symmetry):
            raise ValueError(f"the symmetry of {name} is {symmetry!r}")
        if kind is not None:
            check_name("kind", kind)
        is_open, is_fixed = (_flag(name, what, data.get(what, False)) for what in ("open", "fixed"))
        return ObjectShape(size, cast(Symmetry, symmetry), kind, is_open, is_fixed)

    @property
    def body(self) -> ObjectShape:
        """Size and symmetry alone: what two objects share that look alike."""
        return ObjectShape(self.size_m, self.symmetry)


@dataclass(frozen=True)
class Scene:
    """What is known of the shapes on the table and of the robot's reach in the base frame [m].

    `accuracy_m` and `accuracy_rad` are what the cell sees and does with, one standard deviation; None where nobody
    told.
    """

    objects: Mapping[str, ObjectShape]
    workspace_m: tuple[Range, Range] | None = None
    accuracy_m: float | None = None
    accuracy_rad: float | None = None

    @property
    def sizes(self) -> dict[str, Vector]:
        """The size [m] of each object, by name."""
        return {name: shape.size_m for name, shape in self.objects.items()}

    def to_data(self) -> dict[str, Any]:
        """The JSON of CONTRACT, section 2."""
        objects = {name: shape.to_data() for name, shape in self.objects.items()}
        accuracy = {"accuracy_m": self.accuracy_m, "accuracy_rad": self.accuracy_rad}
        told = {name: value for name, value in accuracy.items() if value is not None}
        workspace = self.workspace_m and [list(pair) for pair in self.workspace_m]
        return {"objects": objects, "workspace_m": workspace, **told}

    @staticmethod
    def of_data(data: Any) -> Scene:
        """The scene that such JSON describes. Raises ValueError with what is wrong with it."""
        try:
            shapes = {str(name): ObjectShape.of_data(name, shape) for name, shape in data.get("objects", {}).items()}
            workspace = data.get("workspace_m")
            accuracy = (_accuracy(data.get(name)) for name in ("accuracy_m", "accuracy_rad"))
            return Scene(shapes, None if workspace is None else _workspace(workspace), *accuracy)
        except (ValueError, TypeError, AttributeError, KeyError, OverflowError, NameRefusedError) as error:
            raise ValueError(f"the scene is not as the contract's section 2 has it: {error}") from error


def _flag(name: str, what: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"whether {name} is {what} is said by true or false, not {value!r}")
    return value


def _accuracy(number: Any) -> float | None:
    if number is None:
        return None
    if (value := _finite(number)) <= 0:
        raise ValueError(f"an accuracy is above 0, not {value!r}")
    return value


def _workspace(pairs: Any) -> tuple[Range, Range]:
    (x0, x1), (y0, y1) = [[_finite(number) for number in pair] for pair in pairs]
    if x0 >= x1 or y0 >= y1:
        raise ValueError("the workspace is empty")
    return ((x0, x1), (y0, y1))


def _finite(number: Any) -> float:
    if isinstance(number, bool) or not math.isfinite(value := float(number)):
        raise ValueError(f"{number!r} is not a finite number")
    return value
