"""Which action comes before which, in every demonstration that shows both (paper, section III-D)."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from typing import TypeVar

Key = TypeVar("Key", bound=Hashable)


def orders(sequences: Collection[Sequence[Key]]) -> set[tuple[Key, Key]]:
    """Every pair (a, b) with a seen before b in some sequence and never after it."""
    seen = {
        (a, b)
        for sequence in sequences
        for place, a in enumerate(sequence)
        for b in sequence[place + 1 :]
        if a != b
    }  # fmt: skip
    return {(a, b) for a, b in seen if (b, a) not in seen}
