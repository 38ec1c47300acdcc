"""Every number of the method, named, with the paper's default or the measurement that it comes from."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from learner.model.condition import DROP_RADIUS_M, PLACE_RADIUS_M


@dataclass(frozen=True)
class PaperParameters:
    """The published method. Sources: the paper, sections III-B to III-E; its reference code, measured."""

    eps_m: float = 0.08
    """DBSCAN's neighbourhood (reference code)."""
    min_samples: int = 3
    """At least so many actions make a cluster (section III-E)."""
    context_score_per_demonstration: float = 20.0
    """Above this score times the number of demonstrations a second cluster tells contexts apart (reference code)."""
    pick_cost: float = 20.0
    place_cost: float = 20.0
    set_gripper_cost: float = 2.0
    """Costs of the actions (reference code)."""
    rollouts: int = 50
    """So many runs in the planner's world before it gives up (reference code)."""
    place_radius_m: float = PLACE_RADIUS_M
    drop_radius_m: float = DROP_RADIUS_M

    def samples_for(self, demonstrations: int) -> int:
        """The samples that make a cluster: a majority above three demonstrations (reference code)."""
        return self.min_samples if demonstrations <= 3 else demonstrations // 2 + 1


@dataclass(frozen=True)
class Parameters:
    """Our method's numbers; `paper` holds those of the plain method."""

    paper: PaperParameters = PaperParameters()

    eps_place_m: float = 0.03
    """Neighbourhood of placements: ten times the hand's noise of 3 mm, below the 5 cm between two stacked cubes."""
    eps_wide_m: float = 0.08
    """Neighbourhood where the narrow one finds nothing, and of what was dropped (the paper's)."""
    eps_pair_m: float = 0.015
    """Two placements this near are no chance where an object has no cluster at all."""
    min_samples: int = 3
    """At least so many actions make a cluster (paper, section III-E)."""
    min_share: float = 0.3
    """A cluster needs this share of the demonstrations, and of the users where there are several."""
    noise_floor_m: float = 0.01
    """Added to a cluster's radius in its score: about the radius that noise alone gives, so that a few samples that lie
    tighter by chance are not worth more than many."""
    place_sigma_m: float = 0.005
    drop_sigma_m: float = 0.03
    """Expected scatter of placed and of dropped objects in the true frame, per axis."""
    sigma_shape: float = 2.0
    """Shape of the inverse gamma distribution of the scatter's variance: how firmly the expectation is held."""
    contact_m: float = 0.15
    """Within this an object may be what the placed one rests on or in."""
    contact_odds: float = 3.0
    """By so much a frame in contact is likelier beforehand than the base; the base than a frame further away."""
    upon_odds: float = 10.0
    """By so much the object that something rests upon is likelier: without it the place would be in the air."""
    sure: float = 0.95
    """Below this posterior probability of a frame the learner asks for a demonstration."""
    transient: float = 0.05
    """If all frames in which an object stays have less than this probability together, its placement does not last."""
    put_back_m: float = PLACE_RADIUS_M
    """An object put down this near to where it was picked up has not been moved: a mistake put back."""
    left_alone_m: float = 0.02
    """What the task had moved before and is put down this near again was put back; further away, others may tell."""
    drop_height_m: float = 0.03
    """Released from higher above its rest, an object was dropped; from lower, and landing tightly, placed."""
    least_drop_m: float = 0.01
    """Called a drop but released from lower above its rest than this, an object may have been placed."""
    tight_m: float = 0.02
    """A set of rests within this of its mean was placed on purpose."""
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

    def samples_for(self, demonstrations: int) -> int:
        """The samples that make a cluster of so many demonstrations."""
        return max(self.min_samples, math.ceil(self.min_share * demonstrations))

    def users_for(self, users: int) -> int:
        """The users that must agree on a cluster: one of one or two, a share of more."""
        return 1 if users < 3 else max(2, math.ceil(self.min_share * users))

    def to_data(self) -> dict[str, Any]:
        """For the manifest."""
        return asdict(self)
