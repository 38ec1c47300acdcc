"""A doubt: what demonstrations have in common and the tree does not reproduce (CONTRACT, section 3)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Doubt:
    """Something in demonstrations, named by their ids, that the tree does not reproduce or a cell cannot do.

    `what` is its kind, a word: 'held' (no cell could believe the pick) or 'signal' (learning does not plan with it),
    and those of `learner.regularities`.
    """

    demonstrations: tuple[str, ...]
    object: str | None
    what: str
    sentence: str

    def to_data(self) -> dict[str, Any]:
        """The JSON of CONTRACT, section 3."""
        return asdict(self) | {"demonstrations": list(self.demonstrations)}
