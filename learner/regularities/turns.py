"""Orientations that were the same each time, though the objects began otherwise turned: no condition asks for them.

What is dropped lies as it falls, and of an object without a known shape nobody knows which turns look the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from learner.inference.targets import Target
from learner.inference.understanding import Understanding
from learner.model.doubt import Doubt
from learner.model.pose import Array, angle_between
from learner.model.poses import Poses
from learner.model.scene import Symmetry
from learner.planning.actions import scene_of
from learner.planning.parameters import MeanParameters
from learner.planning.symmetry import QUARTERS, aligned_in_frame, upright_axis
from learner.regularities.parameters import RegularityParameters
from learner.regularities.told import doubt, share

WHAT: Final = "orientation"
SQUARE: Final = ("cube", "vertical")
"""What looks alike after a quarter turn, or any: people put it square to something by habit, at any of its turns."""


def turns(understood: Understanding, means: MeanParameters, parameters: RegularityParameters) -> Iterator[Doubt]:
    """A doubt for each target at which an object ends turned alike, though it did not begin so."""
    scene = scene_of(understood.demonstrations)
    for target in understood.targets:
        shape = scene.objects.get(target.object) if scene else None
        if not (target.supported and target.type == "place" and shape) or shape.symmetry in SQUARE:
            continue
        if _meant(target, shape.symmetry, understood, means, parameters):
            yield _doubt(target, understood)


def _doubt(target: Target, understood: Understanding) -> Doubt:
    shown = set(understood.moves.demonstration[list(target.members)].tolist())
    name, where = target.object, target.frame
    return doubt(
        understood, shown, name, WHAT,
        f"{name} was turned alike in {where} {share(len(shown), len(shown))}, and began otherwise; the tree places it "
        f"so, but takes for done what lies there turned otherwise; if it does not matter, show it once more turned",
    )  # fmt: skip


def _meant(
    target: Target, symmetry: Symmetry, understood: Understanding, means: MeanParameters,
    parameters: RegularityParameters,
) -> bool:  # fmt: skip
    """Whether the orientations at a target agree as they would not by chance, and those at the picks do not."""
    moves, members = understood.moves, list(target.members)
    picks = moves.picks(np.array(members))
    axis = upright_axis(picks.origin(target.object))
    began = picks.origin(target.frame).inverse() @ picks.origin(target.object)
    agree = _agreeing(target.rests, symmetry, axis, means, parameters)
    chance = (parameters.turned_rad * QUARTERS[symmetry] / math.pi) ** (len(members) - 1)
    return agree and chance < parameters.chance and not _agreeing(began, symmetry, axis, means, parameters)


def _agreeing(
    poses: Poses, symmetry: Symmetry, axis: Array, means: MeanParameters, parameters: RegularityParameters
) -> bool:
    """Whether all orientations of poses (n,) in one frame agree, but for turns that look the same and a few strays."""
    aligned, mean = aligned_in_frame(poses, symmetry, axis, means)
    near = angle_between(aligned, mean) < parameters.turned_rad
    return bool(near.sum() >= (1 - parameters.few / 2) * len(near))
