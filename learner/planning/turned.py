"""Whether an object's orientation matters where it is placed: learned from its spread, up to its symmetry."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from learner.inference.moves import Moves
from learner.inference.targets import Target
from learner.model.pose import Array, Quaternion, angle_between
from learner.model.poses import Poses
from learner.model.scene import Symmetry
from learner.planning.parameters import PlanningParameters
from learner.planning.rounding import rounded, rounded_quaternion
from learner.planning.symmetry import QUARTERS, aligned_in_frame

SQUARE: Final = ("cube", "vertical")
"""What looks alike after a quarter turn, or any: people put it square to something by habit, at any of its turns."""


def turned_at(
    target: Target, moves: Moves, symmetry: Symmetry, axis: Array, parameters: PlanningParameters
) -> tuple[Quaternion, float] | None:
    """The orientation (xyzw) of an object at a target, in its frame, and within what angle [rad] it is that one.

    None where it does not matter: where the orientations do not agree, would often do so by chance, or agreed already
    where the object was picked, so that nobody turned it. `axis` is the object's own that stands upright.
    """
    if symmetry in SQUARE or target.type != "place" or not target.supported:
        return None
    picks, p = moves.picks(np.array(target.members)), parameters.turns
    began = picks.origin(target.frame).inverse() @ picks.origin(target.object)
    by_chance = (p.alike_rad * QUARTERS[symmetry] / math.pi) ** (len(target.members) - 1)
    if by_chance > p.chance or _spread(began, symmetry, axis, parameters) is not None:
        return None
    spread_rad = _spread(target.rests, symmetry, axis, parameters)
    if spread_rad is None:
        return None
    _, mean = aligned_in_frame(target.rests, symmetry, axis, parameters.means)
    angle = min(p.most_rad, p.noise_rad + parameters.spread_radii * spread_rad)
    return rounded_quaternion(mean), rounded(angle)


def _spread(poses: Poses, symmetry: Symmetry, axis: Array, parameters: PlanningParameters) -> float | None:
    """The standard deviation [rad] of the orientations of poses (n,); None if more than a few strays do not agree."""
    aligned, mean = aligned_in_frame(poses, symmetry, axis, parameters.means)
    angles = angle_between(aligned, mean)
    agreeing = angles < parameters.turns.alike_rad
    if agreeing.sum() < (1 - parameters.turns.strays) * len(agreeing):
        return None
    return float(np.sqrt(np.mean(angles[agreeing] ** 2)))
