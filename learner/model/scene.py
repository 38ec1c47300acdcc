"""What is known of the shapes on the table: the scene of CONTRACT, section 2, and its JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

from learner.model.pose import Vector

Symmetry = Literal["none", "cube", "box", "vertical"]
Range = tuple[float, float]


@dataclass(frozen=True)
class ObjectShape:
    """Size [m] along the object's own axes, and which turns of it look the same (CONTRACT, section 2)."""

    size_m: Vector
    symmetry: Symmetry = "none"

    def to_data(self) -> dict[str, Any]:
        """The JSON of CONTRACT, section 2."""
        return {"size_m": list(self.size_m), "symmetry": self.symmetry}

    @staticmethod
    def of_data(name: str, data: Mapping[str, Any]) -> ObjectShape:
        """The shape of the object `name`. Raises ValueError, TypeError or KeyError for what is no shape."""
        size = tuple(_finite(number) for number in data["size_m"])
        symmetry = data.get("symmetry", "none")
        if len(size) != 3 or min(size) <= 0:
            raise ValueError(f"the size of {name} is not three positive lengths")
        if symmetry not in get_args(Symmetry):
            raise ValueError(f"the symmetry of {name} is {symmetry!r}")
        return ObjectShape(size, cast(Symmetry, symmetry))


@dataclass(frozen=True)
class Scene:
    """What is known of the shapes on the table and of the robot's reach in the base frame [m]."""

    objects: Mapping[str, ObjectShape]
    workspace_m: tuple[Range, Range] | None = None

    @property
    def sizes(self) -> dict[str, Vector]:
        """The size [m] of each object, by name."""
        return {name: shape.size_m for name, shape in self.objects.items()}

    def to_data(self) -> dict[str, Any]:
        """The JSON of CONTRACT, section 2."""
        objects = {name: shape.to_data() for name, shape in self.objects.items()}
        return {"objects": objects, "workspace_m": self.workspace_m and [list(pair) for pair in self.workspace_m]}

    @staticmethod
    def of_data(data: Any) -> Scene:
        """The scene that such JSON describes. Raises ValueError with what is wrong with it."""
        try:
            shapes = {str(name): ObjectShape.of_data(name, shape) for name, shape in data.get("objects", {}).items()}
            workspace = data.get("workspace_m")
            return Scene(shapes, None if workspace is None else _workspace(workspace))
        except (ValueError, TypeError, AttributeError, KeyError, OverflowError) as error:
            raise ValueError(f"the scene is not as the contract's section 2 has it: {error}") from error


def _workspace(pairs: Any) -> tuple[Range, Range]:
    (x0, x1), (y0, y1) = [[_finite(number) for number in pair] for pair in pairs]
    if x0 >= x1 or y0 >= y1:
        raise ValueError("the workspace is empty")
    return ((x0, x1), (y0, y1))


def _finite(number: Any) -> float:
    if isinstance(number, bool) or not math.isfinite(value := float(number)):
        raise ValueError(f"{number!r} is not a finite number")
    return value
