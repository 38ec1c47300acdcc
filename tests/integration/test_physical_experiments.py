"""Learned trees do their task in PyBullet with the arm; the experiment's table tells how often."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from experiments.physical import (
    KINDS,
    compute_physical,
    failures,
    in_reach,
    learned_root,
    physical_cells,
    physical_table,
    run_once,
)
from experiments.scenarios import SCENARIOS

from learner.model import GripperIs, Node
from learner.model.tree import leaf
from learner.relations.knowledge import UNKNOWING, Knowledge
from learner.simulation.cell.arm_kinematics import reaches


@pytest.fixture(scope="module")
def learned() -> tuple[Node, Knowledge]:
    """Learned from three demonstrations."""
    return learned_root(in_reach("tower_and_box"), 0)


@pytest.mark.parametrize("kind", ["nothing", "taken", "moved", "box moved", "on top, on a goal"])
def test_a_learned_tree_builds_the_tower_and_fills_the_box_whatever_happens(
    learned: tuple[Node, Knowledge], kind: str
) -> None:
    run = run_once(learned, in_reach("tower_and_box"), 0, kind, 0)
    assert run["happened"]
    assert run["verdict"] == "done", run["attempts"]
    assert run["actions"] <= run["budget"]
    assert run["wrong_picks"] == 0


def test_a_tree_that_does_nothing_is_found_out() -> None:
    run = run_once((leaf(GripperIs("open")), UNKNOWING), in_reach("tower_and_box"), 0, "nothing", 0)
    assert run["verdict"] == "false success"
    assert run["attempts"] == []


def test_starts_are_within_the_arms_reach() -> None:
    for name in SCENARIOS:
        scenario = in_reach(name)
        spots = scenario.draw_start(np.random.default_rng(7))
        assert all(reaches(spot.x, spot.y) for spot in spots.values())


def test_a_cell_keeps_only_runs_in_which_something_happened() -> None:
    (cell,) = physical_cells(["object_in_box"], 1, 1)
    result = compute_physical(cell)
    kinds = {run["kind"] for run in result["runs"]}
    assert {"nothing", "taken"} <= kinds
    assert "covered, buried, wrong tower" not in kinds  # there is one cube


def test_the_table_has_a_row_for_every_task_and_tells_failures() -> None:
    def run(kind: str, verdict: str) -> dict[str, Any]:
        told = {"disturbed": None, "disturbance": "far", "last_reasons": ["Pick A: contact with B"], "run": 1}
        return {"kind": kind, "verdict": verdict, "contacts": 1, "wrong_picks": 0, **told}

    kinds = list(KINDS)
    results = [
        {"scenario": "towers", "number": 0, "runs": [run(kinds[0], "done"), run(kinds[1], "no progress")]},
        {"scenario": "hanoi", "number": 0, "runs": [run(kinds[0], "done")]},
    ]
    lines = physical_table(results).splitlines()
    assert len(lines) == 2 + 3
    assert "| towers | 1 of 1 | 0 of 1 |" in lines[2]
    assert lines[2].endswith("| 50.0 % of 2 | 2 | 0 |")
    assert "66.7 % of 3" in lines[4]
    assert failures(results) == (f"- towers, {kinds[1]} (set 0, run 1): no progress; far; Pick A: contact with B")
    assert failures(results[1:]) == "None failed."
