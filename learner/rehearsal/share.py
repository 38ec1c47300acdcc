"""How many of how many."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Share:
    """`done` of `of`, which is a share of 1 where there were none."""

    done: int
    of: int

    def __float__(self) -> float:
        return self.done / self.of if self.of else 1.0

    def __str__(self) -> str:
        return f"{self.done} of {self.of}"
