"""The proof of each task's tree, and how many wrong trees it refuses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from learner.learning import METHODS
from learner.parameters import Parameters
from learner.proof import AbstractWorld, prove

from .demonstrator import demonstrated
from .mutations import teeth
from .scenarios import BASE, SCENARIOS

SMALL = 20_000
"""Trees with more abstract states than this are proven, but their mutants are not: that takes an hour."""
SET = 31
"""The seed of the one set of demonstrations."""


def proofs_table(names: Iterable[str]) -> str:
    """A row a task: states, whether all were checked, the longest way, the counterexample, mutants refused."""
    head = "| task | states | all of them | most actions | counterexample | mutants refused |\n| --- |" + " --- |" * 5
    return "\n".join([head, *_rows(names)])


def _rows(names: Iterable[str]) -> Iterator[str]:
    for name in names:
        scenario = SCENARIOS[name]
        tree = METHODS["treewright"](demonstrated(scenario, scenario.least, SET), Parameters()).tree
        proven = prove(tree, BASE, np.random.default_rng(0))
        bitten = "not tried"
        if proven.counterexample is None and AbstractWorld(tree.flattened(), BASE).count <= SMALL:
            found = teeth(tree, BASE)
            bitten = f"{found.caught} of {found.different}"
        exhaustive, example = "yes" if proven.exhaustive else "a sample", proven.counterexample or "none"
        yield f"| {name} | {proven.states} | {exhaustive} | {proven.bound} | {example} | {bitten} |"
