"""The proof of each task's tree, and how many wrong trees it refuses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from learner.learned import Learned
from learner.learning import METHODS
from learner.model import Node
from learner.parameters import Parameters
from learner.proof.prover import Certificate, prove
from learner.relations.grasping import Grasp
from learner.relations.things import NO_THINGS, Things

from .cells import KINDS, kept
from .demonstrator import demonstrated
from .disturbances import DISTURBANCES
from .mutations import Teeth, Trial, teeth
from .report import table
from .runner import run
from .scenarios import BASE, SCENARIOS, Scenario

SET: Final = 31
"""The seed of the one set of demonstrations."""
ROUNDS: Final = 6
"""How often everything that happens to robots happens in the runs that tell how good a mutant is."""
MOST: Final = 120
"""Of more mutants, so many are drawn with a seed."""
LARGE: Final = 20_000
MOST_OF_LARGE: Final = 40
ROUNDS_OF_LARGE: Final = 2
"""So many mutants and rounds for trees with more abstract states than LARGE, a proof of which takes seconds."""
HEAD: Final = ("task", "states", "all of them", "most actions", "counterexample", "mutants", "behave otherwise",
               "refused", "as good", "worse, not refused")  # fmt: skip


@dataclass(frozen=True)
class Proven:
    """The tree of a task, proven; and its mutants."""

    scenario: str

    @property
    def key(self) -> str:
        return f"proof-{self.scenario}-{SET}-{MOST}-{ROUNDS}-{MOST_OF_LARGE}-{ROUNDS_OF_LARGE}"


def proofs_table(names: Iterable[str], folder: Path, jobs: int) -> str:
    """Two rows a task: its tree's proof, and its mutants; and the mutants of what only recovers.

    What is in the folder is not computed again.
    """
    found = kept(compute_proof, [Proven(name) for name in names], folder, jobs)
    lines = [f"- {one['scenario']}: {line}" for one in found for line in one["missed"]]
    heading = "Worse than the sound tree, and not refused:"
    return "\n".join(
        [table(HEAD, [row for one in found for row in one["rows"]]), "", heading, "", *(lines or ["None."])]
    )


def compute_proof(cell: Proven) -> dict[str, Any]:
    """The rows of a task, and its mutants that are worse and not refused, in words."""
    scenario = SCENARIOS[cell.scenario]
    learned = METHODS["treewright"](demonstrated(scenario, scenario.least, SET), Parameters())
    proven = prove(learned.tree, BASE, np.random.default_rng(0), levels=5, things=_things(learned))
    bitten = list(_bitten(scenario, learned, proven))
    return {
        "scenario": cell.scenario,
        "rows": [(f"{cell.scenario}{part}", *_proof(proven), *_counts(found)) for part, found in bitten],
        "missed": [str(one) for _, found in bitten if found for one in found.missed],
    }


def _bitten(scenario: Scenario, learned: Learned, proven: Certificate) -> Iterator[tuple[str, Teeth | None]]:
    """The mutants of the tree, and of its SubTrees that only recover; none if it is not proven itself."""
    most, rounds = (MOST_OF_LARGE, ROUNDS_OF_LARGE) if proven.states > LARGE else (MOST, ROUNDS)
    for part, recovery in (("", False), (", recovery", True)):
        sound = proven.counterexample is None
        runs = failures(scenario, rounds, learned.grasps)
        yield part, teeth(learned.tree, BASE, runs, recovery, most, _things(learned)) if sound else None


def _things(learned: Learned) -> Things:
    return learned.draft.things if learned.draft else NO_THINGS


def _proof(proven: Certificate) -> tuple[object, ...]:
    exhaustive, bound = "yes" if proven.exhaustive else "a sample", "-" if proven.bound is None else proven.bound
    return proven.states, exhaustive, bound, proven.counterexample or "none"


def _counts(found: Teeth | None) -> tuple[object, ...]:
    if found is None:
        return ("-",) * 5
    return found.made, found.different, found.caught, len(found.passed) - len(found.missed), len(found.missed)


def failures(scenario: Scenario, rounds: int = ROUNDS, grasps: Sequence[Grasp] = ()) -> Trial:
    """How many of the runs of a scenario, the same for every tree, a tree fails."""

    @cache
    def failed(root: Node) -> tuple[int, int]:
        results = [
            run(root, scenario, number, DISTURBANCES.get(name), when, grasps=grasps)
            for number, (name, when) in enumerate(KINDS * rounds)
        ]
        return sum(not result.success for result in results), len(results)

    return failed
