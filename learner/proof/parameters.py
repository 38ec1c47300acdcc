"""How far the proof looks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ProofParameters:
    """How many states are checked, and which are."""

    exhaustive: int = 1_000_000
    """Up to so many states all are checked."""
    sampled: int = 100_000
    """Of more, so many are drawn."""
    levels: int = 5
    """So many things may lie upon each other; whoever makes the tree says how many it takes down."""
