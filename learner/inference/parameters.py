"""Every number of the inference, with the paper's default or the measurement that it comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass

from learner.model.condition import DROP_HEIGHT_M, DROP_RADIUS_M, PLACE_RADIUS_M


@dataclass(frozen=True)
class InferenceParameters:
    """How clusters, frames, labels and goals are told."""

    eps_place_m: float = 0.03
    """Neighbourhood of placements: ten times the hand's noise of 3 mm, below the 5 cm between two stacked cubes."""
    eps_wide_m: float = 0.08
    """Neighbourhood where the narrow one finds nothing, and of what was dropped (the paper's)."""
    eps_drop_m: float = 2 * DROP_RADIUS_M
    """Neighbourhood of drops of which the wide one finds nothing: so far apart may two lie that are both well done."""
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
    few_unexplained: float = 1 / 3
    """Where more of an object's moves than this share have no target, frames that go by more than one object are tried:
    one of three may have gone wrong."""
    no_frame_odds: float = 0.1
    """By so much likelier than the base it is beforehand that no frame tells a place: people mean something."""
    table_m2: float = 0.5
    """Where no scene tells the workspace, objects without a frame lie anywhere on so large a table [m²]."""
    sure: float = 0.95
    """Below this posterior probability of a frame the learner asks for a demonstration."""
    transient: float = 0.05
    """If all frames in which an object stays have less than this probability together, its placement does not last."""
    put_back_m: float = PLACE_RADIUS_M
    """An object put down this near to where it was picked up has not been moved: a mistake put back."""
    left_alone_m: float = 0.02
    """What the task had moved before and is put down this near again was put back; further away, others may tell."""
    drop_height_m: float = DROP_HEIGHT_M
    """Released from higher above its rest, an object was dropped; from lower, and landing tightly, placed."""
    least_drop_m: float = 0.01
    """Called a drop but released from lower above its rest than this, an object may have been placed."""
    tight_m: float = 0.02
    """A set of rests within this of its mean was placed on purpose."""
    place_radius_m: float = PLACE_RADIUS_M
    """Rests further than this from their mean were not placed (paper, section III-B)."""
    likely: float = 0.02
    """What an object rests upon stands in for a frame that the task keeps rigid with it from this probability on."""
    cube_m: float = 0.05
    """Distances between objects are those between the middles of cubes of this size."""
    lost_m: float = 0.04
    """An object further than this from where it rested in a frame has not kept its place in that frame."""
    upon_radii: float = 1.5
    """What rests within so many times `tight_m` of the middle of another, and high enough, rests upon it."""
    upon_heights: float = 0.4
    """High enough is this share of both heights together above the other's origin; half of each would be exact."""
    same_goal_m: float = 0.049
    """An object that lies this near to a target at the end has reached it, whoever brought it there."""

    def samples_for(self, demonstrations: int) -> int:
        """The samples that make a cluster of so many demonstrations."""
        return max(self.min_samples, math.ceil(self.min_share * demonstrations))

    def users_for(self, users: int) -> int:
        """The users that must agree on a cluster: one of one or two, a share of more."""
        return 1 if users < 3 else max(2, math.ceil(self.min_share * users))
