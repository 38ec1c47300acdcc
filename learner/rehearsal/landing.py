"""Landings: where what is let go comes to rest on a stage, against where it did when it was shown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from learner.model.pose import Vector

Place = tuple[str, str | None]
"""An object, and that within whose outline it came to rest (None: no other)."""


@dataclass(frozen=True)
class Landing:
    """A release of `object`, which came to rest within the outline of `under`.

    `off` is how far from there it comes to rest on the stage [m]; `dropped` if it fell there; `met` is what it would
    meet where it was let go.
    """

    object: str
    under: str | None
    dropped: bool
    off: Vector
    met: str | None = None

    @property
    def away_m(self) -> float:
        """The greater of how far off it is along the table, and in height."""
        x, y, z = self.off
        return max(math.hypot(x, y), abs(z))


def unlike(landings: Iterable[Landing], agreed_m: float) -> Mapping[Place, Vector]:
    """Where what was placed rests elsewhere on the stage than it did, by more than `agreed_m` in the median: how far.

    One placement may be noisy; where several agree, the stage is wrong.
    """
    placed: dict[Place, list[Vector]] = {}
    for landing in landings:
        if not landing.dropped:
            placed.setdefault((landing.object, landing.under), []).append(landing.off)
    several = {place: offs for place, offs in placed.items() if len(offs) > 1}
    medians = {place: tuple(np.median(np.array(offs), axis=0).tolist()) for place, offs in several.items()}
    return {place: off for place, off in medians.items() if math.hypot(*off) > agreed_m}


def sentence_on(landing: Landing, off: Vector) -> str:
    """What comes to rest elsewhere than in the demonstrations, by how much, and what that tells of the stage."""
    x, y, z = off
    if abs(z) > math.hypot(x, y):
        where = f"{1000 * abs(z):.0f} mm {'higher' if z > 0 else 'lower'}"
    else:
        where = f"{1000 * math.hypot(x, y):.0f} mm aside"
    there = landing.under or "what is there"
    return (
        f"{landing.object} comes to rest {where} in simulation than it did each time: {there} may have a pocket or a "
        f"rim, which is not simulated"
    )
