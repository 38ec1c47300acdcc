"""Every number of the published method, with its source."""

from __future__ import annotations

from dataclasses import dataclass

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
