"""How long learning takes as demonstrations grow in number: our method beside the plain one, on the same kitting task.

Ratios of one run, on one core: to the time for ten demonstrations (about linear is about 3 and 10), and to the plain
method's. Proving the tree is timed apart, since it depends on the tree and not on how many demonstrations there were.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from learner.learning import METHODS
from learner.model import Demonstration
from learner.parameters import Parameters
from learner.proof.prover import prove

sys.path.insert(0, str(Path(__file__).parents[1]))  # the experiments make the demonstrations
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS

COUNTS = (10, 30, 100)


def main() -> None:
    """Print the table."""
    shown = demonstrated(SCENARIOS["kitting6"], max(COUNTS), 7)
    METHODS["paper"](shown[:3], Parameters())  # the first call loads what it needs
    seconds = {(name, n): _seconds(name, shown[:n]) for name in METHODS for n in COUNTS}
    print(f"{'kitting6':>12} {'seconds':>8} {'to ten':>7} {'nodes':>6} {'to plain':>9}")
    for (name, n), (spent, nodes) in seconds.items():
        to_ten, to_plain = spent / seconds[name, COUNTS[0]][0], spent / seconds["paper", n][0]
        print(f"{name:>8} {n:>3} {spent:8.2f} {to_ten:7.1f} {nodes:6} {to_plain:9.2f}")
    tree = METHODS["treewright"](shown[:3], Parameters()).tree
    begin = time.perf_counter()
    certificate = prove(tree, "base", np.random.default_rng(0), levels=5)
    print(f"the proof of {certificate.states} states took {time.perf_counter() - begin:.1f} s")


def _seconds(name: str, demonstrations: list[Demonstration]) -> tuple[float, int]:
    begin = time.perf_counter()
    tree = METHODS[name](demonstrations, Parameters()).tree
    return time.perf_counter() - begin, tree.nodes
