"""Which label fits a release: Place or Drop, judged from how high it was released and how tightly the rests lie."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Names, Samples
from learner.model import DemonstratedAction, Demonstration


@dataclass(frozen=True)
class LabelCheck:
    """The label that fits a set of releases of one target, and the evidence in a sentence."""

    type: str
    chosen: str
    evidence: str

    @property
    def corrected(self) -> bool:
        return self.type != self.chosen


def doubts(demonstration: Demonstration, parameters: InferenceParameters) -> Iterator[str]:
    """Sentences on releases of one demonstration whose label does not fit how high the object was released.

    One demonstration tells height alone, so only what is clear is told: placed from above the drop height, or dropped
    from below `least_drop_m`. Learning judges all demonstrations together (see `label_check`).
    """
    for action in demonstration.actions:
        fall = None if action.type == "pick" else _fall_m(action, demonstration.base_frame)
        high = fall is not None and fall > parameters.drop_height_m
        low = fall is not None and fall < parameters.least_drop_m
        if fall is not None and (high if action.type == "place" else low):
            other = "drop" if high else "place"
            yield (
                f"action {action.step} ({action.type} {action.object}): released {1000 * fall:.0f} mm above its rest, "
                f"which fits a {other}; `treewright relabel {demonstration.demonstration_id} {action.step} {other}` "
                f"corrects it"
            )


def _fall_m(action: DemonstratedAction, base_frame: str) -> float | None:
    if not action.rest_seen or action.rest is None:
        return None
    return action.objects[action.object].position[2] - action.rest[base_frame].position[2]


def label_check(samples: Samples, spread_m: float, on_top: bool, parameters: InferenceParameters) -> LabelCheck:
    """The label that fits the releases of one target.

    `spread_m` is the greatest distance of a rest to their mean; `on_top` tells that the object rests upon another
    one, where a drop's cylinder cannot tell on from beside. So: what rests tightly on another was placed; what fell
    from above the drop height was dropped; what was set down low and tightly was placed. In between, and where no rest
    was seen, the operator is right; a person who relabelled is.
    """
    by_person = samples.type[samples.relabelled]
    chosen = _majority(by_person if len(by_person) else samples.type)
    if len(by_person):
        return LabelCheck(chosen, chosen, "a person gave this label afterwards")
    falls = samples.fall_m[~np.isnan(samples.fall_m)]
    if not len(falls):
        return LabelCheck(chosen, chosen, "the object was not seen at rest; the operator's label stands")
    fall = float(np.median(falls))
    evidence = f"released {1000 * fall:.0f} mm above its rest, rests within {1000 * spread_m:.0f} mm of their mean"
    tight = len(samples) >= parameters.min_samples and spread_m < parameters.tight_m
    if tight and on_top:
        return LabelCheck("place", chosen, f"{evidence}, upon another object")
    if fall > parameters.drop_height_m:
        return LabelCheck("drop", chosen, evidence)
    return LabelCheck("place" if tight else chosen, chosen, evidence)


def _majority(labels: Names) -> str:
    """The most frequent label, of equally frequent ones the first by name."""
    names, counts = np.unique(labels, return_counts=True)
    return str(names[np.argmax(counts)])
