"""Places on the way: where most demonstrations bring an object, only to move it on again (a station, a stamp)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from learner.inference.moves import Moves
from learner.inference.targets import Target
from learner.inference.understanding import Understanding
from learner.inference.visits import is_correction
from learner.model.doubt import Doubt
from learner.regularities.parameters import RegularityParameters
from learner.regularities.told import doubt, is_regular, share

WHAT: Final = "visit"


def visits(understood: Understanding, parameters: RegularityParameters) -> Iterator[Doubt]:
    """A doubt for each place that most demonstrations visit and that the tree passes by."""
    for target in understood.passed:
        if not is_correction(target, understood.moves, understood.left_out, understood.parameters):
            yield from _visited(target, understood.left_out.moves, understood, parameters)
    idle = (target for group in understood.groups for target in group.idle)
    for target in (*understood.fleeting, *idle):
        yield from _visited(target, understood.moves, understood, parameters)


def _visited(
    target: Target, moves: Moves, understood: Understanding, parameters: RegularityParameters
) -> Iterator[Doubt]:
    shown = set(moves.demonstration[list(target.members)].tolist())
    everyone = len(understood.demonstrations)
    if not is_regular(shown, parameters.half, understood, parameters):
        return
    name, where = target.object, target.upon[0] if target.upon else target.frame
    yield doubt(
        understood, shown, name, WHAT,
        f"{name} was brought to {where}, and did not stay there, {share(len(shown), everyone)}; the tree does "
        f"not bring it there; if it need not, show it once more without",
    )  # fmt: skip
