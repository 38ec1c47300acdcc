"""How far an object is turned from an orientation, up to the turns of it that look the same (CONTRACT, section 2)."""

from __future__ import annotations

import math
from itertools import product
from typing import Final

import numpy as np

from learner.model.pose import Quaternion, conjugate, multiply
from learner.model.scene import Symmetry

_HALF: Final = math.sqrt(0.5)
_UNITS: Final = [(1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)]
_PAIRS: Final = [
    tuple(_HALF * sign if place == j else _HALF if place == i else 0.0 for place in range(4))
    for i in range(4)
    for j in range(i + 1, 4)
    for sign in (1.0, -1.0)
]
_EIGHTHS: Final = [(a / 2, b / 2, c / 2, 0.5) for a, b, c in product((1.0, -1.0), repeat=3)]
SAME: Final = {
    "none": np.array([_UNITS[3]]),
    "box": np.array(_UNITS),
    "cube": np.array([*_UNITS, *_PAIRS, *_EIGHTHS]),
}
"""The quaternions xyzw (k, 4) of the turns that look the same: none, the half turns of a box, the 24 of a cube."""


def turned_rad(orientation: Quaternion, wanted: Quaternion, symmetry: Symmetry) -> float:
    """The least angle [rad] between two orientations xyzw of an object, up to its symmetry."""
    x, y, z, w = multiply(conjugate(np.array(wanted)), np.array(orientation)).tolist()
    if symmetry == "vertical":
        return 2 * math.atan2(math.hypot(x, y), math.hypot(z, w))
    alike = float(np.abs(SAME[symmetry] @ np.array([x, y, z, w])).max())
    return 2 * math.acos(min(1.0, alike))
