"""From demonstrations to a tree: the registry of methods, and the one call that the pipelines make."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from learner.errors import NothingLearnedError
from learner.learned import Learned
from learner.model import Demonstration
from learner.paper.method import learn_plainly
from learner.parameters import Parameters
from learner.progress import tell
from learner.rehearsal.trial import certify, rehearse_and_repair
from learner.stages import UNSEEN, Stages
from learner.treewright import learn_robustly

Method = Callable[[Sequence[Demonstration], Parameters, Stages], Learned]

METHODS: Final[Mapping[str, Method]] = {"treewright": learn_robustly, "paper": learn_plainly}
DEFAULT_METHOD: Final = "treewright"


def learn(
    demonstrations: Sequence[Demonstration],
    parameters: Parameters | None = None,
    method: str = DEFAULT_METHOD,
    rehearsed: bool = False,
    stages: Stages = UNSEEN,
) -> Learned:
    """The tree that `method` learns from demonstrations of one task; the same input gives the same bytes.

    The tree is proven in the world of its own conditions (learner.proof): the certificate says what was found. If
    `rehearsed`, it is run and repaired in simulation before that, and replayed with the arm: seconds instead of
    fractions of one. The order in which the demonstrations come does not matter. Raises
    NothingLearnedError for no demonstrations, for demonstrations of several tasks or base frames, for an unknown
    method, and where no tree follows.
    """
    if method not in METHODS:
        raise NothingLearnedError(f"no method {method!r}; there are {', '.join(METHODS)}")
    if not demonstrations:
        raise NothingLearnedError("there is no demonstration to learn from")
    for what in ("task", "base_frame", "end_effector_frame"):
        names = sorted({getattr(demonstration, what) for demonstration in demonstrations})
        if len(names) > 1:
            raise NothingLearnedError(
                f"the demonstrations differ in their {what.replace('_', ' ')}: {', '.join(names)}"
            )
    ordered = sorted(demonstrations, key=lambda demonstration: demonstration.demonstration_id)
    parameters = parameters or Parameters()
    tell(f"making a tree from {len(ordered)} demonstrations")
    learned = METHODS[method](ordered, parameters, stages)
    return rehearse_and_repair(learned, ordered, stages) if rehearsed else certify(learned, ordered[0].base_frame)
