"""Every number of the planning, with the paper's default or the measurement that it comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass

from learner.model.condition import DROP_RADIUS_M, PLACE_RADIUS_M


@dataclass(frozen=True)
class PlanningParameters:
    """How grasps, placements and their radii are made."""

    levels: int = 5
    """So many objects upon one are taken down."""
    min_samples: int = 3
    """So many grasps or rests tell their own mean and spread (paper, section III-E)."""
    place_radius_m: float = PLACE_RADIUS_M
    drop_radius_m: float = DROP_RADIUS_M
    """Radii are never above the paper's (section III-B)."""
    noise_radius_m: float = 0.0245
    """Nor so small that 3 mm and 1 degree of perception noise, when placing and when looking, make the robot redo its
    work; just below half of the 5 cm between stacked cubes. Only what must be told apart makes a radius smaller."""
    least_radius_m: float = 0.02
    """Below this a radius never is, whatever must be told apart: the robot would hardly ever find its work done."""
    seen_m: float = 0.003
    seen_rad: float = math.radians(1)
    """Noise of perception at run time, per axis: of a pose's position and of its orientation."""
    sigmas_seen: float = 4.0
    """No radius is below so many standard deviations of what is seen: far from the frame's origin turns matter most."""
    spread_radii: float = 4.0
    """A radius is this many standard deviations of the rests, plus the radius for the noise of perception."""
    aligned_rad: float = math.radians(12)
    """Orientations within this of the densest are averaged with it: several times the hand's noise, within a grasp's
    tolerance."""
