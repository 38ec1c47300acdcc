"""What the rehearsal is worth: trees as planned and as published, in rollouts they were repaired by and in others.

The rollouts are those of `learner.rehearsal`, judged by what the learner has understood: they tell whether the tree
does that, not whether it is the task. The tables on success tell the latter, of trees that were not rehearsed.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from statistics import median
from typing import Any, Final

from learner.errors import LearnerError
from learner.learned import Learned
from learner.learning import learn
from learner.model import Demonstration, Tree
from learner.planning.draft import Draft
from learner.rehearsal.goal import goals_of
from learner.rehearsal.rehearsal import Rehearsal, rehearse
from learner.rehearsal.stage import Stage

from .cells import GENERATED, Cell, scenario_of
from .report import grouped, name_of, table

SETS: Final = 4
"""Sets of demonstrations of each task that we wrote."""
SEEDS: Final = 20
"""Tasks that nobody wrote, one set each."""
UNSEEN: Final = (1, 2)
"""Seeds of rollouts that no tree was repaired by."""
HEAD: Final = ("task", "cell", "sets", "rollouts", "done as planned", "done as published", "repaired sets",
               "unseen: failing as planned", "unseen: failing as published", "replayed", "sets without replay",
               "seconds (median)", "seconds (most)")  # fmt: skip
Result = dict[str, Any]


def rehearsal_cells(names: Iterable[str], sets: int, seeds: int) -> list[Cell]:
    """Our tasks by an expert, and tasks that nobody wrote, every other in a real cell; the fewest demonstrations."""
    ours = [_cell(name, "expert", number) for name in names for number in range(sets)]
    return ours + [_cell(f"{GENERATED}{seed}", ("expert", "real")[seed % 2], seed) for seed in range(seeds)]


def _cell(name: str, users: str, number: int) -> Cell:
    return Cell("rehearsal", name, "treewright", users, max(3, scenario_of(name).least), number, 0)


def compute_rehearsal(cell: Cell) -> Result:
    """Learn as `treewright learn` does, then compare with the tree as it was planned."""
    demonstrations = sorted(cell.demonstrate(), key=lambda demonstration: demonstration.demonstration_id)
    begin = time.perf_counter()
    try:
        learned = learn(demonstrations, rehearsed=True)
    except LearnerError as error:
        return {**asdict(cell), "refused": str(error)}
    seconds = time.perf_counter() - begin
    return {**asdict(cell), "seconds": round(seconds, 2), **_told(learned), **compared(learned, demonstrations)}


def _told(learned: Learned) -> Result:
    """What the manifest says."""
    rehearsal, replay = learned.report["rehearsal"], learned.report["replay"]
    return {
        "rollouts": rehearsal["rollouts"],
        "published": rehearsal["done"],
        "repairs": rehearsal.get("repairs", []),
        "failures": rehearsal.get("failures", []),
        "replay": replay["runs"],
        "reason": replay["reason"],
        "counterexample": (learned.certificate or {}).get("counterexample"),
    }


def compared(learned: Learned, demonstrations: Sequence[Demonstration]) -> Result:
    """The rollouts that the planned tree did, and how many unseen ones each tree fails; where they are the same tree,
    the former are those of the published one, and the latter are not run."""
    if learned.draft is None or not learned.report["rehearsal"].get("repairs"):
        return {"planned": learned.report["rehearsal"].get("done", 0), "unseen": None}
    planned, stage = learned.draft.tree(), Stage(demonstrations)
    first, *before = _rehearsed(planned, learned.draft, stage, (0, *UNSEEN))
    after = list(_rehearsed(learned.tree, learned.draft, stage, UNSEEN))
    unseen = {"rollouts": sum(len(each.results) for each in before), "planned": _failing(before),
              "published": _failing(after)}  # fmt: skip
    return {"planned": len(first.results) - len(first.failures), "unseen": unseen}


def _rehearsed(tree: Tree, draft: Draft, stage: Stage, seeds: Iterable[int]) -> Iterator[Rehearsal]:
    goals = goals_of(draft.understood.groups, draft.placements, stage)
    return (rehearse(tree, stage, goals, seed, draft.grasps) for seed in seeds)


def _failing(rehearsals: Iterable[Rehearsal]) -> int:
    return sum(len(rehearsal.failures) for rehearsal in rehearsals)


def rehearsals_table(results: Sequence[Result]) -> str:
    """One row per task, those that nobody wrote together by cell, then all; below what was repaired and what fails."""
    learned = [r | {"task": _task(r)} for r in results if "refused" not in r]
    rows = [(task, users, *_row(cells)) for (task, users), cells in grouped(learned, "task", "users").items()]
    rows += [("all", "", *_row(learned))] if learned else []
    return "\n\n".join([
        table(HEAD, rows),
        "What was repaired, the first of each set:",
        _listed(f"{name_of(r)}: {_first(r['repairs'])}" for r in learned if r["repairs"]),
        "What still fails, the first of each set:",
        _listed(_remaining(results)),
    ])  # fmt: skip


def _task(result: Result) -> str:
    return "tasks that nobody wrote" if result["scenario"].startswith(GENERATED) else str(result["scenario"])


def _row(cells: Sequence[Result]) -> tuple[object, ...]:
    rollouts, planned, published = (sum(r[key] for r in cells) for key in ("rollouts", "planned", "published"))
    unseen = [r["unseen"] for r in cells if r["unseen"]]
    runs = [run["verdict"] == "done" for r in cells for run in r["replay"]]
    seconds = [r["seconds"] for r in cells]
    return (
        len(cells), rollouts, planned, published, sum(bool(r["repairs"]) for r in cells),
        *(_of(unseen, which) for which in ("planned", "published")),
        f"{sum(runs)} of {len(runs)}" if runs else "-", sum(not r["replay"] for r in cells),
        f"{median(seconds):.1f}", f"{max(seconds):.1f}",
    )  # fmt: skip


def _of(unseen: Sequence[Result], which: str) -> str:
    return f"{sum(u[which] for u in unseen)} of {sum(u['rollouts'] for u in unseen)}" if unseen else "-"


def _remaining(results: Sequence[Result]) -> Iterator[str]:
    for result in results:
        if "refused" in result:
            yield f"{name_of(result)}: refused: {result['refused']}"
            continue
        replayed = [f"replay: {run['sentence']}" for run in result["replay"] if run["verdict"] != "done"]
        unproven = [f"not proven: {result['counterexample']}"] if result["counterexample"] else []
        failing = [*unproven, *result["failures"][:1], *replayed[:1]]
        if failing:
            yield f"{name_of(result)}: {' | '.join(failing)}"


def _first(sentences: Sequence[str]) -> str:
    more = f"; and {len(sentences) - 1} more" if len(sentences) > 1 else ""
    return f"{sentences[0]}{more}"


def _listed(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines) or "None."
