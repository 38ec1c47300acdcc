"""Learned trees run in PyBullet with the arm: every task, every kind of disturbance, judged by the truth of physics.

The starts are those of the kinematic runs as far as the arm reaches them: a ring around its base. Failing runs keep
their attempts, so that a reader can tell a tree's fault from an arm's:

    python -m tests.experiments.physical TASK KIND SET RUN     prints one run
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from learner.learning import METHODS
from learner.model import Node
from learner.parameters import Parameters
from learner.relations.knowledge import Knowledge
from learner.simulation.cell.arm_kinematics import reaches
from learner.simulation.kinematic_world import Behavior
from learner.simulation.physical_world import PhysicalWorld

from .demonstrator import demonstrated
from .disturbances import DISTURBANCES, When
from .report import share, table
from .runner import judge
from .scenarios import SCENARIOS, Scenario

SETS: Final = 5
"""Sets of demonstrations a task ..."""
RUNS: Final = 4
"""... and runs a set and kind."""
FIRST_SET: Final = 50
STEPS_PER_ACTION: Final = 42
"""Periods that the arm takes for an action, about."""
KINDS: Final[Mapping[str, tuple[tuple[str, When], ...]]] = {
    "nothing": (("none", "progress"),),
    "moved": (("far", "progress"), ("beside", "progress"), ("far", "after"), ("beside", "after")),
    "on top, on a goal": (
        ("on_top", "progress"), ("on_goal", "progress"), ("on_top", "after"), ("on_goal", "after"),
    ),
    "taken": (("taken", "progress"),),
    "box moved": (("container", "progress"), ("container", "after")),
    "helper, failing skills": (("helper", "progress"), ("failing", "progress")),
    "covered, buried, wrong tower": (
        ("covered", "progress"), ("buried", "progress"), ("wrong_tower", "progress"), ("covered", "after"),
        ("buried", "after"),
    ),
}  # fmt: skip
"""What happens to the robot, pooled; the runs of a kind take the disturbances in turn."""


@dataclass(frozen=True)
class PhysicalCell:
    """One set of demonstrations of a task, learned by our method, and its runs of every kind."""

    scenario: str
    number: int
    runs: int

    @property
    def key(self) -> str:
        return f"physical-{self.scenario}-{self.number}-{self.runs}"


def physical_cells(names: Iterable[str], sets: int = SETS, runs: int = RUNS) -> list[PhysicalCell]:
    """Every task with several sets of demonstrations."""
    return [PhysicalCell(name, number, runs) for name in names for number in range(sets)]


def in_reach(name: str) -> Scenario:
    """A task that begins and ends where the arm reaches."""
    return replace(SCENARIOS[name], reaches=reaches)


def compute_physical(cell: PhysicalCell) -> dict[str, Any]:
    """Learn, and run what can happen."""
    scenario = in_reach(cell.scenario)
    learned = learned_root(scenario, cell.number)
    runs = [
        {"kind": kind, "run": number, **run_once(learned, scenario, cell.number, kind, number)}
        for kind in KINDS
        for number in range(cell.runs)
    ]
    return {**asdict(cell), "runs": [run for run in runs if run["happened"]]}


def learned_root(scenario: Scenario, number: int) -> tuple[Node, Knowledge]:
    """The flattened tree of our method from the set of that number, and what it is answered by."""
    demonstrations = demonstrated(scenario, scenario.least, FIRST_SET + number)
    learned = METHODS["treewright"](demonstrations, Parameters())
    root = learned.tree.flattened()
    return root, Knowledge.of(root, learned.grasps)


def run_once(learned: tuple[Node, Knowledge], scenario: Scenario, cell: int, kind: str, number: int) -> dict[str, Any]:
    """One run, as JSON: whether its disturbance could happen (`happened`), and what was done if it failed."""
    name, when = KINDS[kind][(RUNS * cell + number) % len(KINDS[kind])]
    disturbance = DISTURBANCES.get(name)
    seed = 1000 * (cell + 1) + number
    rng = np.random.default_rng([seed, *kind.encode()])
    root, knowledge = learned
    behavior = Behavior(failing=disturbance.failing if disturbance else 0.0, opens_on_loss=bool(rng.integers(2)))
    with PhysicalWorld(
        scenario.objects,
        scenario.draw_start(np.random.default_rng(seed)),
        rng,
        behavior=behavior,
        knowledge=knowledge,
    ) as world:
        result = judge(root, world, scenario, seed, rng, disturbance, when, STEPS_PER_ACTION)
        happened = disturbance is None or disturbance.happen is None or result.disturbed is not None
        attempts = (
            [] if result.success else [f"{d.step} {d.kind} {d.object} {d.frame}: {d.failure}" for d in world.attempts]
        )
    return {**asdict(result), "happened": happened, "attempts": attempts}


def physical_table(results: Sequence[Mapping[str, Any]]) -> str:
    """A row a task, a column a kind; and all together."""
    names = list(dict.fromkeys(result["scenario"] for result in results))
    rows = [_row(name, [run for result in results if result["scenario"] == name for run in result["runs"]])
            for name in names]  # fmt: skip
    every = [run for result in results for run in result["runs"]]
    return table(["task", *KINDS, "all", "contacts", "wrong picks"], [*rows, _row("all", every)])


def _row(name: str, runs: Sequence[dict[str, Any]]) -> list[object]:
    by_kind = [[run for run in runs if run["kind"] == kind] for kind in KINDS]
    faults = [sum(run[fault] for run in runs) for fault in ("contacts", "wrong_picks")]
    return [name, *map(_of, by_kind), share(runs), *faults]


def _of(runs: Sequence[dict[str, Any]]) -> str:
    done = sum(run["verdict"] == "done" for run in runs)
    return f"{done} of {len(runs)}" if runs else "-"


def failures(results: Sequence[Mapping[str, Any]]) -> str:
    """A line for each run that failed."""
    return "\n".join(_lines(results)) or "None failed."


def _lines(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    for result in results:
        for run in result["runs"]:
            if run["verdict"] != "done":
                what = run["disturbed"] or run["disturbance"]
                last = "; ".join(dict.fromkeys(run["last_reasons"])) or "no failed action"
                where = f"set {result['number']}, run {run['run']}"
                yield f"- {result['scenario']}, {run['kind']} ({where}): {run['verdict']}; {what}; {last}"


def _show(name: str, kind: str, cell: int, number: int) -> dict[str, Any]:
    scenario = in_reach(name)
    return run_once(learned_root(scenario, cell), scenario, cell, kind, number)


if __name__ == "__main__":
    shown = _show(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
    print(
        "\n".join(f"{key}: {value}" for key, value in shown.items() if key != "attempts"), *shown["attempts"], sep="\n"
    )
