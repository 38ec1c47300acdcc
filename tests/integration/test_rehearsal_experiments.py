"""The experiment on the rehearsal counts each tree's rollouts under that tree's name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from experiments.cells import kept
from experiments.demonstrator import demonstrated
from experiments.rehearsals import compared, compute_rehearsal, rehearsal_cells, rehearsals_table
from experiments.scenarios import SCENARIOS

from learner.learning import METHODS
from learner.model import Demonstration
from learner.parameters import Parameters
from learner.planning.draft import Draft

Demonstrations = list[Demonstration]


@pytest.fixture(scope="module")
def board() -> Demonstrations:
    found = demonstrated(SCENARIOS["board"], 3, 5)
    return sorted(found, key=lambda demonstration: demonstration.demonstration_id)


def test_unseen_rollouts_tell_a_worse_published_tree_from_the_planned_one(board: Demonstrations) -> None:
    """As if a repair had lost the last placement."""
    right = METHODS["treewright"](board, Parameters())
    assert right.draft
    group = right.draft.understood.groups[0]
    shorter = replace(right.draft.understood, groups=(replace(group, subgoals=group.subgoals[:-1]),))
    report = {**right.report, "rehearsal": {"done": 0, "repairs": ["the last placement is left out"]}}
    found = compared(replace(right, tree=Draft(shorter, Parameters().planning, {}).tree(), report=report), board)
    assert found["unseen"]["published"] == found["unseen"]["rollouts"] > 20
    assert found["unseen"]["planned"] <= 0.1 * found["unseen"]["rollouts"]
    assert found["planned"] >= 0.45 * found["unseen"]["rollouts"]


def test_a_set_is_learned_once_and_its_row_counts_its_rollouts_and_replays(tmp_path: Path) -> None:
    cells = rehearsal_cells(["object_in_box"], 1, 0)
    (result,) = kept(compute_rehearsal, cells, tmp_path, 1, progress=False)
    assert result["published"] >= result["planned"] >= 0.9 * result["rollouts"] > 10
    (path,) = tmp_path.iterdir()
    before = path.stat().st_mtime_ns
    assert kept(compute_rehearsal, cells, tmp_path, 1, progress=False) == [result]
    assert path.stat().st_mtime_ns == before
    done = sum(run["verdict"] == "done" for run in result["replay"])
    row = next(line for line in rehearsals_table([result]).splitlines() if line.startswith("| object_in_box"))
    assert f"| {result['rollouts']} | {result['planned']} | {result['published']} |" in row
    assert f"| {done} of {len(result['replay'])} |" in row


def test_sets_that_fail_or_are_refused_are_named(tmp_path: Path) -> None:
    (cell, *_) = rehearsal_cells(["object_in_box"], 1, 0)
    (result,) = kept(compute_rehearsal, [cell], tmp_path, 1, progress=False)
    failed = {**result, "number": 1, "counterexample": "the gripper closed"}
    refused = {key: result[key] for key in ("scenario", "method", "users", "demonstrations")}
    told = rehearsals_table([result, failed, {**refused, "number": 2, "refused": "nothing was moved"}])
    assert "set 1: not proven: the gripper closed" in told
    assert "set 2: refused: nothing was moved" in told
    assert "| object_in_box | expert | 2 |" in told
