"""What learning costs: whole commands, what each further demonstration adds, and clustering alone, with memory.

    commands       `treewright learn` on a lake that is filled, process start included: ours, the plain method, their
                   ratio, and the peak of memory; every task of the paper with few demonstrations, two with very many
    understanding  all up to the groups, in this process: seconds, per demonstration, and growth against the number;
                   beside it the plain method, as long as it ends in a minute
    clustering     DBSCAN of many positions of an honest distribution in every candidate frame: what was demonstrated is
                   tight in the true frame, loose in that of a container, and anywhere in the others; beside it
                   scikit-learn's, as long as its lists of neighbours fit into memory

Figures of one run on one machine; compare the ratios. `python -m tests.bench learner` takes about five minutes.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from sklearn.cluster import DBSCAN

from learner.inference.dbscan import dbscan
from learner.inference.parameters import InferenceParameters
from learner.inference.understanding import understand
from learner.model import Demonstration
from learner.model.pose import Array
from learner.paper.method import learn_plainly
from learner.parameters import Parameters
from pipelines.home import Home
from storage.lake import Lake

sys.path.insert(0, str(Path(__file__).parents[1]))  # the experiments make the demonstrations
from experiments.demonstrator import demonstrated
from experiments.scenarios import PAPER, SCENARIOS
from experiments.users import EXPERT

COMMANDS = (
    *((name, count, 1) for name in PAPER for count in (3, 10)),
    ("kitting4", 400, 20),
    ("object_in_box", 2000, 20),
)
MOST_PLAIN = 1_000
"""So many demonstrations the plain method ends with in a minute."""
MOST_LISTED = 10_000
"""Of so many points in one place scikit-learn's lists of neighbours take 1.4 GB."""
COUNTS = (1_000, 10_000, 100_000)
SHOWN = 500
"""So many different demonstrations are simulated; more are these again under other names."""
POINTS = (10_000, 100_000, 1_000_000)
FRAMES = {"true": (0.003, 0.003, 0.003), "container": (0.02, 0.02, 0.003), "other": (0.3, 0.2, 0.01)}
"""The scatter per axis [m] of what was demonstrated, in each frame."""


def main() -> None:
    """Print the three tables."""
    _commands()
    _understanding()
    _clustering()


def _commands() -> None:
    print(f"{'learn':>14} {'demos':>6} {'users':>5} {'ours s':>7} {'plain s':>8} {'ratio':>6} {'MB':>5}")
    for name, count, users in COMMANDS:
        with tempfile.TemporaryDirectory() as folder:
            crew = [replace(EXPERT, name=f"u{number:02d}") for number in range(users)]
            Lake(Home(Path(folder)).lake).add_all(demonstrated(SCENARIOS[name], count, 5, crew))
            ours, memory_mb = _timed(folder, name)
            plain, _ = _timed(folder, name, "--method", "paper")
        print(
            f"{name:>14} {count:6} {users:5} {ours:7.1f} {plain:8.1f} {ours / plain:6.2f} {memory_mb:5.0f}", flush=True
        )


def _timed(folder: str, task: str, *options: str) -> tuple[float, float]:
    """Seconds of the whole command, and its peak of memory [MB]."""
    command = [sys.executable, "-m", "pipelines.cli", "learn", task, "--json", *options]
    begin = time.perf_counter()
    child = subprocess.Popen(command, env={**os.environ, "TREEWRIGHT_HOME": folder}, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with {child.returncode}")
    return time.perf_counter() - begin, usage.ru_maxrss / 1024


def _understanding() -> None:
    shown = demonstrated(SCENARIOS["object_in_box"], SHOWN, 7)
    print(f"{'understanding':>14} {'seconds':>8} {'ms each':>8} {'to first':>9} {'MB':>6} {'plain s':>8} {'ratio':>6}")
    first = 0.0
    for count in COUNTS:
        many = _tiled(shown, count)
        spent, memory_mb = _in_a_process(_understood, many)
        first = first or spent / count
        each = spent / count
        plain = _beside(spent, _learned_plainly, many) if count <= MOST_PLAIN else ""
        print(f"{count:14} {spent:8.2f} {1000 * each:8.3f} {each / first:9.2f} {memory_mb:6.0f} {plain}", flush=True)


def _beside(ours: float, work: Callable[..., object], *arguments: object) -> str:
    """Seconds of what does the same otherwise, and the ratio of ours to it."""
    spent, _ = _in_a_process(work, *arguments)
    return f"{spent:8.2f} {ours / spent:6.2f}"


def _tiled(shown: Sequence[Demonstration], count: int) -> list[Demonstration]:
    return [replace(shown[n % len(shown)], demonstration_id=f"d{n:06d}") for n in range(count)]


def _understood(demonstrations: Sequence[Demonstration]) -> None:
    understand(demonstrations, InferenceParameters())


def _learned_plainly(demonstrations: Sequence[Demonstration]) -> None:
    learn_plainly(demonstrations, Parameters())


def _clustering() -> None:
    parameters = InferenceParameters()
    print(f"{'clustering':>14} {'frame':>10} {'seconds':>8} {'us each':>8} {'MB':>6} {'sklearn':>8} {'ratio':>6}")
    for count in POINTS:
        for frame, scatter_m in FRAMES.items():
            points = np.random.default_rng(3).normal(0.0, scatter_m, (count, 3))
            least, eps_m = parameters.samples_for(count), parameters.eps_wide_m
            spent, memory_mb = _in_a_process(dbscan, points, eps_m, least)
            theirs = _beside(spent, _clustered, points, eps_m, least) if count <= MOST_LISTED else ""
            each_us = 1e6 * spent / count
            print(f"{count:14} {frame:>10} {spent:8.2f} {each_us:8.2f} {memory_mb:6.0f} {theirs}", flush=True)


def _clustered(points: Array, eps_m: float, least: int) -> None:
    DBSCAN(eps=eps_m, min_samples=least).fit(points)


def _in_a_process(work: Callable[..., object], *arguments: object) -> tuple[float, float]:
    """Seconds of some work in a process of its own, and that process's peak of memory [MB]."""
    with multiprocessing.get_context("fork").Pool(1) as pool:
        found: tuple[float, float] = pool.apply(_measured, (work, *arguments))
        return found


def _measured(work: Callable[..., object], *arguments: object) -> tuple[float, float]:
    begin = time.perf_counter()
    work(*arguments)
    return time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
