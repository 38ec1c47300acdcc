"""Every number of the planning, with the paper's default or the measurement that it comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from learner.model.condition import DROP_RADIUS_M, PLACE_RADIUS_M
from learner.model.scene import Scene


@dataclass(frozen=True)
class MeanParameters:
    """How the mean of poses is formed of which some are wrong."""

    aligned_rad: float = math.radians(12)
    """Orientations within this of the densest are averaged with it: several times the hand's noise, within a grasp's
    tolerance."""
    references: int = 40
    """At most so many of the poses are tried as the one that the others are turned to."""
    compared: int = 300
    """It is chosen by how densely at most so many of them lie about it."""
    outlying: float = 3.0
    """A position is left out if it is further from the median than this many median distances ..."""
    outlying_m: float = 0.005
    """... and than this: nearer, noise alone explains it."""


@dataclass(frozen=True)
class GraspParameters:
    """Which objects that nobody picked a gripper can grasp, and how."""

    stroke_m: float = 0.08
    """What is wider in both directions is not grasped unless it was demonstrated: a parallel gripper opens about so
    far."""
    square_m: float = 0.01
    """Sides that differ by less are alike to a gripper."""
    parallel: float = 0.999
    """Two axes whose cosine is above this are one."""


@dataclass(frozen=True)
class RecoveryParameters:
    """What covers, and where things are put aside."""

    levels: int = 5
    """Piles of so many objects upon one are proven to be taken down."""
    cover_radius_m: float = 0.035
    """An object's origin this near to the middle of the place above another covers it, where no scene tells sizes."""
    upright: float = 0.5
    """The directions that pointed up are averaged; if the mean is shorter than this, they tell nothing."""
    on_table_m: float = 0.015
    """An object at most this much higher than the lowest of its shape stood on the table."""
    beside_m: float = 0.015
    """What rests further from the upright axis of an object is beside it, not upon it."""
    spots: int = 6
    """So many spots are tried for what is put aside, where no scene tells sizes."""
    inner: float = 0.75
    """They are among this share of the places where objects have lain, those furthest inside."""
    raised_m: float = 0.003
    """What is put aside is let go this much above the table."""


@dataclass(frozen=True)
class TurnParameters:
    """Whether an orientation matters."""

    alike_rad: float = math.radians(12)
    """Orientations within this of their mean are the same: several times the hand's noise."""
    strays: float = 1 / 6
    """At most this share of them may be otherwise."""
    chance: float = 0.02
    """Orientations that would agree more often than so if nobody cared tell nothing."""
    noise_rad: float = math.radians(10)
    """A condition's angle is this, for what is seen and grasped askew, and `spread_radii` deviations more, ..."""
    most_rad: float = math.radians(25)
    """... but never more than this."""


@dataclass(frozen=True)
class PlanningParameters:
    """How grasps, placements and their radii are made, and what recovers.

    What perception noise decides is that of a cell which sees and does with `seen_m` and `seen_rad`; see `for_cell`.
    """

    means: MeanParameters = field(default_factory=MeanParameters)
    grasps: GraspParameters = field(default_factory=GraspParameters)
    turns: TurnParameters = field(default_factory=TurnParameters)
    recovery: RecoveryParameters = field(default_factory=RecoveryParameters)
    min_samples: int = 3
    """So many grasps or rests tell their own mean and spread (paper, section III-E)."""
    place_radius_m: float = PLACE_RADIUS_M
    drop_radius_m: float = DROP_RADIUS_M
    """Radii are never above the paper's (section III-B)."""
    seen_m: float = 0.003
    seen_rad: float = math.radians(1)
    """What a cell sees and does with where no scene tells its accuracy (CONTRACT, section 2): one standard deviation
    of a pose's position per axis, and of its orientation."""
    noise_radius_m: float = 0.0245
    """Radii are not so small that this noise, when placing and when looking, makes the robot redo its work: 4 times
    sqrt(2) for placing and looking, times sqrt(2) for object and frame; below half of the 5 cm between stacked cubes.
    Only what must be told apart makes a radius smaller."""
    least_radius_m: float = 0.02
    """Below this a radius never is, whatever must be told apart: the robot would hardly ever find its work done."""
    sigmas_seen: float = 4.0
    """No radius is below so many standard deviations of what is seen: far from the frame's origin turns matter most."""
    spread_radii: float = 4.0
    """Where the rests scatter more than that noise explains, a radius takes in so many standard deviations more."""
    apart: float = 0.49
    """A radius is at most this share of the distance to the nearest other target: the two spheres do not meet."""
    same_rest_m: float = 0.02
    """Targets nearer than this in the base, of which one was left again, are equal places: not to be told apart."""
    below_lowest: float = 0.7
    """A radius is at most this share of the lowest object's height: what stands upon another is not in its place."""
    release_clearance_m: float = 0.005
    """How far above its rest an object is let go where the operator's label of a drop was corrected to a placement."""
    sunk_sigmas: float = 3.0
    """What lies deeper than so many standard deviations of a look below the top of what holds it lies in a pocket."""

    def for_cell(self, scene: Scene | None) -> PlanningParameters:
        """The same for a cell whose scene tells its accuracy: what noise decides grows and shrinks with that."""
        seen_m = scene.accuracy_m if scene and scene.accuracy_m else self.seen_m
        seen_rad = scene.accuracy_rad if scene and scene.accuracy_rad else self.seen_rad
        finer, turns = seen_m / self.seen_m, self.turns
        return replace(
            self, seen_m=seen_m, seen_rad=seen_rad,
            noise_radius_m=finer * self.noise_radius_m, least_radius_m=finer * self.least_radius_m,
            same_rest_m=finer * self.same_rest_m,
            turns=replace(turns, noise_rad=seen_rad / self.seen_rad * turns.noise_rad),
        )  # fmt: skip
