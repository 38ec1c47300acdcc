"""Every number of the proof."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ProofParameters:
    """How many states are checked, and when things of the abstract world are at one place, upon or in one another.

    How high a pile may be is no number of the proof: whoever has made the tree says how much it takes down.
    """

    exhaustive: int = 1_000_000
    """Up to so many states all are checked."""
    sampled: int = 100_000
    """Of more, so many are drawn."""
    probe: int = 4_000
    """So many states tell how many more there are with one more object."""
    chunk: int = 40_000
    """So many states are looked at together: their columns stay in the processor's cache."""
    same_m: float = 0.015
    """Two positions in one frame this near are one location."""
    rests_m: float = 0.03
    """A placement leads to the location in its frame this near to where the object is let go."""
    overlap_m: float = 0.03
    """Nearer than this two objects cannot lie beside each other; one that much higher or lower is upon the other."""
    support_m: float = 0.05
    """What lies lower than an object and this near to its vertical may carry it."""
    upon_m: tuple[float, float] = (0.02, 0.08)
    """By more than the first and less than the second an origin lies higher than that of what it covers."""
    alike_m: float = 0.012
    """Locations upon an object that differ by less in height are of things that lie directly upon it."""
    far_m: float = 1e6
    """A free spot on the table is so far [m] from all that a tree speaks of."""
    same_direction: float = 0.9
    """Two directions from an object's origin are one where their cosine is above this."""
