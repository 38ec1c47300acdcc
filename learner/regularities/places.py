"""Placements that no frame of an object or the base explains: said, with what would explain them where that is known.

A place may be told by two objects, by an object and the base's axes, or by where something stood at the beginning
(`learner.model.frame`); it may be anywhere along a line or in an area. Else nothing that was seen decides it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from learner.inference.finding import find_richer
from learner.inference.frames import NO_FRAME, intended, log_density, log_density_anywhere, posterior, richer_frames
from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Samples
from learner.inference.understanding import Understanding
from learner.model.condition import PLACE_RADIUS_M
from learner.model.doubt import Doubt
from learner.model.frame import AXES, START, objects_of
from learner.model.pose import Array
from learner.model.poses import Rows
from learner.regularities.parameters import RegularityParameters
from learner.regularities.told import doubt, is_regular, share

WHAT: Final = "place"
LEAST_SIDE_M: Final = 2 * PLACE_RADIUS_M
"""What is narrower than a place is no area, and what is shorter no line."""
_TWICE: Final = (
    "to find out what decides it, show it twice from one and the same start: where both end alike, something that is "
    "seen there tells the place"
)


def unexplained_places(understood: Understanding, parameters: RegularityParameters) -> Iterator[Doubt]:
    """A doubt for each object that more than a few demonstrations bring to where no target is."""
    moves = understood.moves
    for name in np.unique(moves.object[moves.released]).tolist():
        shown = np.flatnonzero(moves.released & (moves.object == name) & ~moves.put_back)
        left = np.setdiff1d(shown, _explained(understood))
        if is_regular(moves.demonstration[left].tolist(), parameters.few, understood, parameters):
            yield _unexplained(str(name), left, understood, parameters)


def wide_places(understood: Understanding, parameters: RegularityParameters) -> Iterator[Doubt]:
    """A doubt for each target of which some placements lie further from their mean than a placement may."""
    for target in understood.targets:
        if target.supported and target.type == "place" and target.spread_m > understood.parameters.place_radius_m:
            samples = understood.moves.releases(target.members)
            where, then = _stretched(samples, understood, parameters) or (f"up to {_cm(target.spread_m)} apart", _TWICE)
            demonstrations = understood.moves.demonstration[list(target.members)].tolist()
            sentence = (
                f"{target.object} was placed {where} {share(len(set(demonstrations)), len(set(demonstrations)))}; the "
                f"tree places it in the middle, and takes for done only what lies near it; {then}"
            )
            yield doubt(understood, demonstrations, target.object, WHAT, sentence)


def _cm(length_m: float) -> str:
    return f"{100 * length_m:.0f} cm"


def _explained(understood: Understanding) -> list[int]:
    """The moves that reach a target, or a place where the object does not stay."""
    targets = [target for target in understood.targets if target.supported]
    return [number for target in (*targets, *understood.fleeting) for number in target.members]


def _unexplained(name: str, left: Rows, understood: Understanding, parameters: RegularityParameters) -> Doubt:
    moves = understood.moves
    demonstrations = np.unique(moves.demonstration[left]).tolist()
    moved = f"{name} was moved {share(len(demonstrations), len(understood.demonstrations))}"
    where, then = _where(name, left, understood, parameters)
    sentence = f"{moved} {where}; the tree does not reproduce it; {then}"
    return doubt(understood, demonstrations, name, WHAT, sentence)


def _where(name: str, left: Rows, understood: Understanding, parameters: RegularityParameters) -> tuple[str, str]:
    """Where to, in words, and the demonstration that would decide it."""
    richer = find_richer(left, understood.moves, understood.parameters)
    if richer and 2 * sum(len(target.members) for target in richer) > len(left):
        return _by_frame(richer[0].frame, name)
    along = _stretched(understood.moves.releases(left), understood, parameters)
    return along or ("to a place that no frame explains", _TWICE)


def _by_frame(frame: str, name: str) -> tuple[str, str]:
    objects = objects_of(frame)
    if frame.endswith(START):
        (home,) = objects
        where = "back to where it stood" if home == name else f"to a place told by where {home} stood"
        return f"{where} at the beginning", f"to check it, show it once more with {home} starting elsewhere"
    if frame.endswith(AXES):
        where = f"to a place beside {objects[0]} along the axes of the base"
        return where, f"to check it, turn {objects[0]} and show it once more"
    both = " and ".join(objects)
    return f"to a place told by both {both}", f"to check it, move {both} further apart and show it once more"


def _stretched(samples: Samples, understood: Understanding, parameters: RegularityParameters) -> tuple[str, str] | None:
    """A line or an area in which the places lie, if the evidence speaks for one; None if not."""
    numbers = understood.parameters
    if len(samples) < numbers.min_samples:
        return None
    axes = [frame for frame in richer_frames(samples) if frame.endswith(AXES)]
    logs = {
        f"{frame} {form}": value
        for frame in (*samples.common_frames, *axes)
        for form, value in _forms(intended(frame, samples, numbers), numbers).items()
    }
    shares = posterior(
        {NO_FRAME: log_density_anywhere(samples, numbers.place_sigma_m, numbers), **logs},
        {NO_FRAME: 1.0, **dict.fromkeys(logs, 1 / len(logs))},
    )
    likeliest, probability = next(iter(shares.items()))
    if likeliest == NO_FRAME or probability < parameters.likely:
        return None
    frame, form = likeliest.split()
    return _in_words(frame, form, samples.base)


def _forms(points: Array, parameters: InferenceParameters) -> dict[str, float]:
    """The log densities of `points` (n, 3) along the lines of x and of y, and in an area, at a height that scatters."""
    sigma_m, shape = parameters.place_sigma_m, parameters.sigma_shape
    lines = {"x": (1, 0), "y": (0, 1)}
    along = {
        axis: log_density(points[:, [fixed, 2]], sigma_m, shape) - _evenly(points[:, [free]])
        for axis, (fixed, free) in lines.items()
    }
    return {**along, "area": log_density(points[:, 2:], sigma_m, shape) - _evenly(points[:, :2])}


def _evenly(points: Array) -> float:
    """Minus the log density of all `points` (n, d) but one, spread evenly over a box about as large as they tell."""
    count = len(points)
    sides = (points.max(axis=0) - points.min(axis=0)) * (count + 1) / (count - 1)
    return (count - 1) * float(np.log(np.maximum(sides, LEAST_SIDE_M)).sum())


def _in_words(frame: str, form: str, base: str) -> tuple[str, str]:
    name = objects_of(frame)[0]
    whose = frame if frame in (base, name) else f"the base, from {name}"
    if form == "area":
        return f"anywhere in an area of {whose}", "to bound it, show it once more at each of its corners"
    return f"anywhere along the {form} axis of {whose}", "to bound it, show it once more at each of its ends"
