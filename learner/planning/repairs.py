"""Repairs: what the planner is to do otherwise than the demonstrations alone say, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from learner.inference.targets import Target


@dataclass(frozen=True)
class Repairs:
    """What the planner is to do otherwise.

    widened: for a target the objects that occupy its place even when they stand only partly on it. before: pairs of
    targets of which the first is to be reached first.
    """

    widened: frozenset[tuple[Target, str]] = frozenset()
    before: frozenset[tuple[Target, Target]] = frozenset()

    def __or__(self, other: Repairs) -> Repairs:
        """Both; of two contrary orders the first."""
        before = self.before | {(a, b) for a, b in other.before if (b, a) not in self.before}
        return Repairs(self.widened | other.widened, before)

    def sentences(self) -> list[str]:
        """For the manifest."""
        return [
            *sorted(f"{b} occupies the place of {t.object} in {t.frame} even partly" for t, b in self.widened),
            *sorted(f"{a.object} in {a.frame} comes before {b.object} in {b.frame}" for a, b in self.before),
        ]


NOTHING: Final = Repairs()
