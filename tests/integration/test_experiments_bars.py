"""A small version of the experiments' bars: every task and user, several seeds, judged by the world's truth.

`make experiments` runs the same code with ten sets of demonstrations per task; EXPERIMENTS.md has its tables.
"""

from __future__ import annotations

from typing import Any

import pytest
from experiments.cells import KINDS, Cell, compute
from experiments.report import beyond, limit, plain, runs_of
from experiments.scenarios import SCENARIOS
from experiments.users import FOURTEEN

RUNS = len(KINDS)
UNDERSTAND = [user.name for user in FOURTEEN if user.name not in ("user13", "user14")]


def successes(runs: list[dict[str, Any]]) -> int:
    return sum(run["verdict"] == "done" for run in runs)


@pytest.fixture(scope="module", params=list(SCENARIOS))
def task(request: pytest.FixtureRequest) -> dict[str, Any]:
    scenario = SCENARIOS[request.param]
    return compute(Cell("success", scenario.name, "treewright", "real", scenario.least, 0, RUNS))


def test_the_nominal_tree_keeps_to_the_bar_on_size(task: dict[str, Any]) -> None:
    assert task["nodes"] <= limit([task])


def test_the_task_is_done_whatever_happens_to_the_robot(task: dict[str, Any]) -> None:
    runs = runs_of([task], plain)
    assert successes(runs) >= len(runs) - 1


def test_the_tree_never_says_that_an_unfinished_task_is_done(task: dict[str, Any]) -> None:
    assert [run for run in task["runs"] if run["verdict"] == "false success"] == []


def test_the_tree_finds_a_way_out_where_no_demonstration_shows_one(task: dict[str, Any]) -> None:
    runs = runs_of([task], beyond)
    assert successes(runs) >= len(runs) - 1


@pytest.mark.parametrize("name", UNDERSTAND)
def test_three_demonstrations_of_one_user_make_a_working_tree(name: str) -> None:
    result = compute(Cell("users", "tower_and_box", "treewright", name, 3, 0, 11))
    runs = runs_of([result], plain)
    assert successes(runs) >= len(runs) - 1
    assert "false success" not in {run["verdict"] for run in result["runs"]}


def test_the_demonstrations_of_all_users_together_make_a_working_tree() -> None:
    result = compute(Cell("users", "tower_and_box", "treewright", "all", 1, 0, 11))
    assert successes(runs_of([result], plain)) == len(runs_of([result], plain))
    assert result["nodes"] <= limit([result])


def test_more_demonstrations_do_not_make_the_tree_larger() -> None:
    few, many = (compute(Cell("size", "kitting4", "treewright", "expert", count, 0, 0)) for count in (3, 12))
    assert many["nodes"] <= few["nodes"]
