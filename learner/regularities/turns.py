"""Orientations that most demonstrations share, but not enough for the tree to ask for them, or that nobody varied."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from learner.inference.targets import Target
from learner.inference.understanding import Understanding
from learner.model import Place
from learner.model.doubt import Doubt
from learner.model.pose import angle_between
from learner.model.poses import Mask, Poses
from learner.planning.actions import LearnedActions
from learner.planning.symmetry import QUARTERS, aligned_in_frame
from learner.planning.turned import SQUARE
from learner.regularities.parameters import RegularityParameters
from learner.regularities.told import doubt, share

WHAT: Final = "orientation"


def turns(understood: Understanding, actions: LearnedActions, parameters: RegularityParameters) -> Iterator[Doubt]:
    """A doubt for each placement that most demonstrations turn alike, and the tree leaves as it comes."""
    for target in _any_way_round(actions):
        rests, began = _agreeing(target, target.rests, actions), _began(target, actions)
        often = int(rests.sum())
        is_rule = often > parameters.most * len(rests) and _chance(target, often, actions) < parameters.chance
        if is_rule and often > began.sum():
            numbers = understood.moves.demonstration[np.array(target.members)[rests]].tolist()
            yield doubt(
                understood, numbers, target.object, WHAT,
                f"{target.object} was turned alike at {target.frame} {share(often, len(rests))}; the tree leaves it as "
                f"it comes; if it matters, show it once more so, else turned otherwise",
            )  # fmt: skip


def questions_on(actions: LearnedActions, parameters: RegularityParameters) -> list[dict[str, Any]]:
    """A question for each placement at which an object was turned alike, and already was so where it was picked."""
    return [
        _question(target)
        for target in _any_way_round(actions)
        if _is_first(target, actions)
        and _chance(target, len(target.members), actions) < parameters.chance
        and _agreeing(target, target.rests, actions).all()
        and _began(target, actions).all()
    ]


def _question(target: Target) -> dict[str, Any]:
    show = f"turn {target.object} before you begin"
    sentence = (
        f"place {target.object}: it lay the same way round at {target.frame} each time, and at each start; whether "
        f"that matters cannot be told; to decide it, {show} and demonstrate once more"
    )
    return {"action": f"place {target.object}", "frame": target.frame, "rival": None, "certainty": None,
            "show": show, "sentence": sentence}  # fmt: skip


def _any_way_round(actions: LearnedActions) -> Iterator[Target]:
    """The placements of objects of which not all turns look the same, at which the tree asks for none."""
    known = actions.scene.objects if actions.scene else {}
    for target, placement in actions.placements.items():
        turned = isinstance(placement, Place) and placement.turned is None and target.supported
        if turned and target.object in known and known[target.object].symmetry not in SQUARE:
            yield target


def _is_first(target: Target, actions: LearnedActions) -> bool:
    """Whether the object is taken there from where it stood at the start."""
    moves, members = actions.moves, np.array(target.members)
    own = np.flatnonzero(moves.object == target.object)
    _, firsts = np.unique(moves.demonstration[own], return_index=True)
    return bool(np.isin(members, own[firsts]).all())


def _began(target: Target, actions: LearnedActions) -> Mask:
    """Which of the object's orientations in the target's frame agreed where it was picked."""
    picks = actions.moves.picks(np.array(target.members))
    return _agreeing(target, picks.origin(target.frame).inverse() @ picks.origin(target.object), actions)


def _agreeing(target: Target, poses: Poses, actions: LearnedActions) -> Mask:
    """Which of an object's poses (n,) are turned as most of them are, up to its symmetry."""
    symmetry, axis, p = actions.scene.objects[target.object].symmetry, actions.axes[target.object], actions.parameters  # type: ignore[union-attr]  # known
    aligned, mean = aligned_in_frame(poses, symmetry, axis, p.means)
    return np.asarray(angle_between(aligned, mean) < p.turns.alike_rad)


def _chance(target: Target, often: int, actions: LearnedActions) -> float:
    """How often so many of the orientations would agree if nobody cared."""
    assert actions.scene is not None
    quarters = QUARTERS[actions.scene.objects[target.object].symmetry]
    alike = actions.parameters.turns.alike_rad * quarters / math.pi
    return math.comb(len(target.members), often) * alike ** (often - 1)
