"""What a person corrects afterwards in the presses of a recording: their types, and what is taken back.

The recording stays as it was. Of several corrections of one action the newest counts, so that one that was taken back
returns with a type.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from learner.model.demonstration import ActionType
from learner.observation.presses import Numbered

Meant = ActionType | Literal["undo"]
"""The type that an action was meant to have, or that it does not count."""


@dataclass(frozen=True)
class Correction:
    """What a person says afterwards of the action with this number."""

    step: int
    type: Meant


def corrected(presses: Iterable[Numbered], corrections: Sequence[Correction]) -> list[Numbered]:
    """The presses as they were meant; each keeps its number."""
    meant = {correction.step: correction.type for correction in corrections}
    return [
        Numbered(each.step, replace(each.press, type=meant.get(each.step, each.press.type)))
        for each in presses
        if meant.get(each.step) != "undo"
    ]


def told(presses: Iterable[Numbered], corrections: Sequence[Correction]) -> list[str]:
    """A sentence about each press that was corrected."""
    meant = {correction.step: correction.type for correction in corrections}
    changed = [each for each in presses if meant.get(each.step, each.press.type) != each.press.type]
    return [f"action {each.step} ({each.press.type}) was afterwards {_made(meant[each.step])}" for each in changed]


def _made(meant: Meant) -> str:
    return "taken back" if meant == "undo" else f"made a {meant}"
