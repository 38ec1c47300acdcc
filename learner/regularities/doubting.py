"""All doubts about what was understood."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from learner.inference.understanding import Understanding
from learner.model.doubt import Doubt
from learner.planning.actions import LearnedActions
from learner.regularities.choices import choices
from learner.regularities.exceptions import exceptions
from learner.regularities.exceptions import questions_on as exceptions_asked
from learner.regularities.kinds import kinds
from learner.regularities.parameters import RegularityParameters
from learner.regularities.places import unexplained_places, wide_places
from learner.regularities.precision import indistinct_places
from learner.regularities.returns import returns
from learner.regularities.turns import questions_on as turns_asked
from learner.regularities.turns import turns
from learner.regularities.visits import visits


def doubts_about(
    understood: Understanding, actions: LearnedActions, parameters: RegularityParameters
) -> tuple[Doubt, ...]:
    """What the demonstrations have in common and a tree with these `actions` does not reproduce."""
    found = (
        *unexplained_places(understood, parameters),
        *wide_places(understood, parameters),
        *indistinct_places(understood, actions, parameters),
        *turns(understood, actions, parameters),
        *choices(understood, parameters),
        *visits(understood, parameters),
        *returns(understood, parameters),
        *kinds(understood, actions.scene, parameters),
    )
    return (*found, *exceptions(understood, found, parameters))


def asked_about(
    understood: Understanding, actions: LearnedActions, doubts: Sequence[Doubt], parameters: RegularityParameters
) -> list[dict[str, Any]]:
    """What cannot be told from these demonstrations, and is not doubted already: what to show next."""
    return [*exceptions_asked(understood, doubts, parameters), *turns_asked(actions, parameters)]
