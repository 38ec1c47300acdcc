"""Every number by which regularities are told, with the reason or the measurement that it comes from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RegularityParameters:
    """How much must have something in common before it is told."""

    few: float = 1 / 3
    """More than this share of the demonstrations is no exception: one of three may have gone wrong."""
    most: float = 2 / 3
    """More than this share of the demonstrations does something as a rule: of three all, since two may err alike."""
    half: float = 1 / 2
    """More than this share visits a place on the way: a correction is what a minority does."""
    asked: float = 0.25
    """From this share on it is asked whether an exception was a mistake: it may be another case."""
    least: int = 2
    """One demonstration has nothing in common with itself."""
    likely: float = 0.8
    """From this probability on a shape of place (a line, an area) is named."""
    told_apart: float = 0.9
    """Two places are told apart by a radius of at most this share of the distance between them."""
    chance: float = 0.02
    """Starts that would tell two goals apart so rarely by chance do tell them apart."""
