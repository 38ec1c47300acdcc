"""The experiment on tasks that nobody wrote (`generated`): its cells and its table."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any, Final

from .cells import GENERATED, HABITUAL, POINTS, Cell, scenario_of
from .report import beyond, false_successes, limit, plain, runs_of, share, table, worst

COUNTS: Final = (3, 4, 3, 6, 3, 10)
"""Demonstrations, in turn."""
SURE: Final = 0.95
HOW: Final = {
    GENERATED: "starts anywhere",
    HABITUAL: "some things hardly moved between demonstrations",
    POINTS: "starts anywhere, no scene",
}
Result = dict[str, Any]


def unwritten_cells(seeds: int, runs: int) -> list[Cell]:
    """Every task by an expert and in a real cell; and in the real cell alone with little variety, and without scene."""
    kinds = [(GENERATED, "expert"), (GENERATED, "real"), (HABITUAL, "real"), (POINTS, "real")]
    return [
        Cell(experiment, f"{GENERATED}{seed}", "treewright", users, _count(seed), seed, runs)
        for (experiment, users), seed in product(kinds, range(seeds))
    ]


def _count(seed: int) -> int:
    return max(COUNTS[seed % len(COUNTS)], scenario_of(f"{GENERATED}{seed}").least)


def unwritten_table(results: Sequence[Result]) -> str:
    """One row per way of demonstrating and whether the learner asked a question.

    `wrong`: of the actions whose frame was called at least 95 % certain, those told in a frame that is neither the
    script's nor fixed to it by the task.
    """
    head = ("demonstrations", "cell", "learner", "tasks", "done", "worst task", "false success", "recovery",
            "certain frames", "wrong", "over the bar on size")  # fmt: skip
    rows = []
    for experiment, users, asked in product(HOW, ("expert", "real"), (False, True)):
        cells = [r for r in results if (r["experiment"], r["users"]) == (experiment, users) and _asked(r) == asked]
        if cells:
            certain = [f for r in cells for f in r.get("frames", ()) if f["certainty"] >= SURE]
            wrong = sum(not f["right"] and not f["as_good"] for f in certain)
            runs = runs_of(cells, plain)
            rows.append((HOW[experiment], users, "asks" if asked else "is sure", len(cells), share(runs), worst(cells),
                         false_successes(runs_of(cells)), share(runs_of(cells, beyond)), len(certain), wrong,
                         sum(too_large(r) for r in cells)))  # fmt: skip
    return table(head, rows)


def _asked(result: Result) -> bool:
    """Whether the learner said that it does not know enough; a refusal says so too."""
    return "refused" in result or bool(result["questions"])


def too_large(result: Result) -> bool:
    """Whether the nominal tree is over the bar on size."""
    most = limit([result])
    return isinstance(most, int) and result["nodes"] > most
