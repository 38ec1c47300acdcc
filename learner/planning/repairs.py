"""Repairs: what the planner is to do otherwise than the demonstrations alone say, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from learner.inference.targets import Target


@dataclass(frozen=True)
class Repairs:
    """What the planner is to do otherwise: of each pair of targets in `before` the first is to be reached first."""

    before: frozenset[tuple[Target, Target]] = frozenset()

    def __or__(self, other: Repairs) -> Repairs:
        """Both; of two contrary orders the first."""
        return Repairs(self.before | {(a, b) for a, b in other.before if (b, a) not in self.before})

    def sentences(self) -> list[str]:
        """For the manifest."""
        return sorted(f"{a.object} in {a.frame} comes before {b.object} in {b.frame}" for a, b in self.before)


NOTHING: Final = Repairs()
