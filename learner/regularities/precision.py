"""Places that a cell cannot tell apart: by what it sees, done would be said of a part that lies otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from learner.inference.targets import Target
from learner.inference.understanding import Understanding
from learner.model import Place
from learner.model.doubt import Doubt
from learner.planning.actions import LearnedActions
from learner.regularities.parameters import RegularityParameters
from learner.regularities.told import doubt

WHAT: Final = "precision"


def indistinct_places(
    understood: Understanding, actions: LearnedActions, parameters: RegularityParameters
) -> Iterator[Doubt]:
    """A doubt for each placement whose condition holds too where another object lies, or upon the rim of its pocket."""
    for target, placement in actions.placements.items():
        if isinstance(placement, Place) and target.supported:
            near = dict(_near(target, actions))
            nearest = min(near, key=near.__getitem__, default=None)
            if nearest is not None and placement.radius > parameters.told_apart * near[nearest]:
                numbers = understood.moves.demonstration[list(target.members)].tolist()
                sentence = _sentence(target, nearest, near[nearest], actions.parameters.seen_m)
                yield doubt(understood, numbers, target.object, WHAT, sentence)


def _near(target: Target, actions: LearnedActions) -> Iterator[tuple[str, float]]:
    """What it must be told apart from, in words, and how far [m] that is away."""
    if target in actions.nearest_m:
        yield "the place of another object", actions.nearest_m[target]
    yield f"the rim of {target.frame}, should it not go in", actions.pocket_m(target)


def _sentence(target: Target, other: str, away_m: float, seen_m: float) -> str:
    return (
        f"{target.object} at {target.frame} comes to rest {_mm(away_m)} from {other}, and a cell that sees with "
        f"{_mm(seen_m)} cannot tell one from the other; if it sees better, tell accuracy_m in the scene, and show it "
        f"once more"
    )


def _mm(length_m: float) -> str:
    return f"{1000 * length_m:.2g} mm"
