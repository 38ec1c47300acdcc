"""All doubts about what was understood."""

from __future__ import annotations

from learner.inference.understanding import Understanding
from learner.model.doubt import Doubt
from learner.planning.actions import LearnedActions
from learner.regularities.choices import choices
from learner.regularities.parameters import RegularityParameters
from learner.regularities.places import unexplained_places, wide_places
from learner.regularities.precision import indistinct_places
from learner.regularities.returns import returns
from learner.regularities.visits import visits


def doubts_about(
    understood: Understanding, actions: LearnedActions, parameters: RegularityParameters
) -> tuple[Doubt, ...]:
    """What the demonstrations have in common and a tree with these `actions` does not reproduce."""
    return (
        *unexplained_places(understood, parameters),
        *wide_places(understood, parameters),
        *indistinct_places(understood, actions, parameters),
        *choices(understood, parameters),
        *visits(understood, parameters),
        *returns(understood, parameters),
    )
