"""Tasks that nobody wrote: a small version of the experiment, judged by the world's truth.

`make experiments` runs the same code on sixty tasks; EXPERIMENTS.md has the table.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from experiments.cells import compute
from experiments.demonstrator import demonstrate
from experiments.generated import generated
from experiments.report import plain, runs_of
from experiments.scenarios import BASE
from experiments.unwritten import SURE, too_large, unwritten_cells

from learner.learning import METHODS
from learner.model import Recording
from learner.observation import observe
from learner.parameters import Parameters

SEEDS, RUNS = 10, 3
Result = dict[str, Any]


@pytest.fixture(scope="module")
def tasks() -> list[Result]:
    with ProcessPoolExecutor(2) as pool:
        return list(pool.map(compute, (cell for cell in unwritten_cells(SEEDS, RUNS) if cell.users == "real")))


def certain(results: list[Result]) -> list[dict[str, Any]]:
    return [frame for result in results for frame in result["frames"] if frame["certainty"] >= SURE]


def test_a_seed_always_draws_the_same_task() -> None:
    again = generated.__wrapped__
    for seed in range(5):
        assert again(seed) == generated(seed)
        start = generated(seed).draw_start(np.random.default_rng(seed))
        assert set(start) == set(generated(seed).objects)


def test_every_task_can_be_learned(tasks: list[Result]) -> None:
    assert len(tasks) == 3 * SEEDS
    assert [result["refused"] for result in tasks if "refused" in result] == []


def test_a_tree_of_which_the_learner_is_sure_does_the_task(tasks: list[Result]) -> None:
    runs = runs_of([result for result in tasks if not result["questions"]], plain)
    assert len(runs) > SEEDS * RUNS
    assert sum(run["verdict"] == "done" for run in runs) >= 0.97 * len(runs)
    assert "false success" not in {run["verdict"] for run in runs}


def test_a_frame_that_is_called_certain_is_right(tasks: list[Result]) -> None:
    assert len(certain(tasks)) > 3 * SEEDS
    assert [frame for frame in certain(tasks) if not frame["right"] and not frame["as_good"]] == []


def test_no_tree_is_larger_than_the_bar(tasks: list[Result]) -> None:
    assert [result["scenario"] for result in tasks if too_large(result)] == []


def test_the_name_of_the_base_frame_does_not_matter() -> None:
    shown = [demonstrate(generated(7), np.random.default_rng([7, number]), number=number) for number in range(3)]
    usual, renamed = (METHODS["treewright"]([observe(each) for each in recordings], Parameters())
                      for recordings in (shown, [based(each, "world-2.table") for each in shown]))  # fmt: skip
    assert renamed.tree.nodes == usual.tree.nodes
    assert frames(renamed.report) == [(name, "world-2.table" if frame == BASE else frame)
                                      for name, frame in frames(usual.report)]  # fmt: skip


def based(recording: Recording, base_frame: str) -> Recording:
    return replace(recording, base_frame=base_frame, parents=frozenset({base_frame}))


def frames(report: dict[str, Any]) -> list[tuple[str, str]]:
    return [(action["object"], action["frame"]) for action in report["actions"]]
