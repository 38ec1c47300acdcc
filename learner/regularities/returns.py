"""What is taken and put back where it stood: a goal that holds at the start already, so that the tree has none."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from learner.inference.understanding import Understanding
from learner.model.doubt import Doubt
from learner.regularities.parameters import RegularityParameters
from learner.regularities.told import doubt, is_regular, share

WHAT: Final = "start"


def returns(understood: Understanding, parameters: RegularityParameters) -> Iterator[Doubt]:
    """A doubt for each object that most demonstrations take and put back where it was taken, and bring nowhere else."""
    moves, everyone = understood.moves, len(understood.demonstrations)
    reached = [number for target in understood.targets if target.supported for number in target.members]
    elsewhere = {target.object for target in understood.targets if target.supported}
    back = np.setdiff1d(np.flatnonzero(moves.put_back), reached)
    for name in sorted({*moves.object[back].tolist()} - elsewhere):
        shown = np.unique(moves.demonstration[back[moves.object[back] == name]]).tolist()
        if is_regular(shown, parameters.most, understood, parameters):
            yield doubt(
                understood, shown, name, WHAT,
                f"{name} was taken and put back where it stood {share(len(shown), everyone)}: that holds at the start "
                f"already, and the tree does nothing with {name}; if something is to come of it, show what, elsewhere",
            )  # fmt: skip
