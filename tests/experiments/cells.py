"""The experiments' cells: one set of demonstrations, learned by one method, run many times; kept as JSON.

A cell that is in the folder is not computed again, so an interrupted session goes on where it stopped.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

from learner.errors import LearnerError
from learner.learning import METHODS
from learner.model import Demonstration, Node
from learner.parameters import Parameters
from learner.relations.grasping import Grasp
from learner.simulation.script import ScriptedMove

from .demonstrator import crooked_markers, demonstrated
from .disturbances import DISTURBANCES, When
from .generated import generated, habitual
from .runner import Result, run
from .scenarios import SCENARIOS, Scenario
from .users import EXPERT, FOURTEEN, REAL, User

KINDS: Final[tuple[tuple[str, When], ...]] = (
    ("none", "progress"),
    *((name, "progress") for name in DISTURBANCES),
    *((name, "after") for name, disturbance in DISTURBANCES.items() if disturbance.after),
)
"""What the runs of a cell are disturbed by, in turn."""
USERS: Final[dict[str, tuple[User, ...]]] = {
    "expert": (EXPERT,),
    "real": (REAL,),
    "pooled": FOURTEEN[:12],
    "all": FOURTEEN,
    **{user.name: (user,) for user in FOURTEEN},
}
"""Who demonstrates, by the name that a cell has for them."""


NOMINAL: Final = "treewright without recovery"
"""Our method's tree without the SubTrees that only recover."""
GENERATED: Final = "generated"
"""The experiment on tasks that nobody wrote: a cell's `scenario` is this with the task's seed, its `number`, too."""
HABITUAL: Final = "habitual"
"""The same, shown by people who hardly tidy up."""
POINTS: Final = "points"
"""The same, without a scene: objects are points."""


@dataclass(frozen=True)
class Cell:
    """What is computed: `demonstrations` in all, users taking turns (of several users: so many of each).

    `method` is one of the learner's, or NOMINAL.
    """

    experiment: str
    scenario: str
    method: str
    users: str
    demonstrations: int
    number: int
    runs: int

    @property
    def key(self) -> str:
        return "-".join(str(part).replace(" ", "_") for part in asdict(self).values())

    def demonstrate(self) -> list[Demonstration]:
        """The cell's set of demonstrations; the same for every method and number of runs."""
        users, scenario = USERS[self.users], scenario_of(self.scenario)
        shown = habitual(scenario, self.number) if self.experiment == HABITUAL else scenario
        found = demonstrated(shown, self.demonstrations, 1000 + self.number, users, each=len(users) > 1)
        return [replace(each, scene=None) for each in found] if self.experiment == POINTS else found


def scenario_of(name: str) -> Scenario:
    """A task by its name: one of ours, or one that nobody wrote."""
    return SCENARIOS[name] if name in SCENARIOS else generated(int(name.removeprefix(GENERATED)))


def compute(cell: Cell) -> dict[str, Any]:
    """Demonstrate, learn, run; a refusal to learn is a result too. The proof is looked at apart: see `proofs`."""
    demonstrations = cell.demonstrate()
    begin = time.perf_counter()
    try:
        learned = METHODS["treewright" if cell.method == NOMINAL else cell.method](demonstrations, Parameters())
    except LearnerError as error:
        return {**asdict(cell), "refused": str(error), "runs": []}
    except Exception as error:
        error.add_note(f"in the experiments' cell {cell.key}")
        raise
    seconds = time.perf_counter() - begin
    scenario, tree = scenario_of(cell.scenario), learned.tree
    root = tree.flattened(recovery=cell.method != NOMINAL)
    return {
        **asdict(cell),
        "seconds": round(seconds, 3),
        "nodes": tree.nodes,
        "nodes_recovery": root.size - tree.nodes,
        "nodes_written": tree.nodes_written,
        "k": scenario.placements,
        "groups": len(learned.report.get("groups", ())),
        "frames": _frames(scenario, learned.report),
        "questions": len(learned.report.get("questions", ())),
        "notes": list(learned.notes),
        "runs": [asdict(result) for result in _runs(cell, scenario, root, learned.grasps)],
    }


def _frames(scenario: Scenario, report: dict[str, Any]) -> list[dict[str, Any]]:
    """For each learned action the frame, how sure the learner is of it, and whether it is right.

    `right`: a script names this frame. `as_good`: the frame is fixed to that one, because one was placed in the other
    (or both in a third) before, so that no demonstration of this script tells them apart.
    """
    return [
        {"object": action["object"], "frame": action["frame"], "certainty": action["certainty"],
         "right": any((step.object, step.frame) == (action["object"], action["frame"])
                      for script in scenario.scripts for step in script),
         "as_good": any(_as_good(script, action["object"], action["frame"]) for script in scenario.scripts)}
        for action in report.get("actions", ())
        if action.get("certainty") is not None  # the plain method does not say, nor is a default frame sure
    ]  # fmt: skip


def _as_good(script: Sequence[ScriptedMove], name: str, frame: str) -> bool:
    fixed_to: dict[str, str] = {}
    for step in script:
        anchor = fixed_to.get(step.frame, step.frame)
        if step.object == name and anchor == fixed_to.get(frame, frame):
            return True
        fixed_to[step.object] = anchor
    return False


def _runs(cell: Cell, scenario: Scenario, root: Node, grasps: Sequence[Grasp]) -> Iterator[Result]:
    (user, *_) = USERS[cell.users]
    markers = crooked_markers(sorted(scenario.objects), user) if user.crooked_rad else {}
    written = cell.scenario in SCENARIOS
    for number in range(cell.runs):
        name, when = KINDS[(number if written else number + cell.number * cell.runs) % len(KINDS)]
        seed = 100_000 * (cell.number + 1) + number
        yield run(root, scenario, seed, DISTURBANCES.get(name), when, markers=markers, grasps=grasps)


class Keyed(Protocol):
    """What has a name of its own, under which its result is kept."""

    @property
    def key(self) -> str: ...


C = TypeVar("C", bound=Keyed)
Work = Callable[[C], dict[str, Any]]


def results(cells: Sequence[Cell], folder: Path, jobs: int, progress: bool = True) -> list[dict[str, Any]]:
    """The results of cells, computed where they are not in the folder yet, `jobs` at a time."""
    return kept(compute, cells, folder, jobs, progress)


def kept(work: Work[C], cells: Sequence[C], folder: Path, jobs: int, progress: bool = True) -> list[dict[str, Any]]:
    """As `results`, for cells of any kind and the `work` that computes one."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [cell for cell in cells if not _path(folder, cell).exists()]
    with ProcessPoolExecutor(jobs) as pool:
        for count, (cell, result) in enumerate(zip(missing, pool.map(work, missing), strict=True), start=1):
            _write(_path(folder, cell), result)
            if progress:
                print(f"{count}/{len(missing)} {cell.key}", flush=True)
    return [json.loads(_path(folder, cell).read_text()) for cell in cells]


def _path(folder: Path, cell: Keyed) -> Path:
    return folder / f"{cell.key}.json"


def _write(path: Path, result: dict[str, Any]) -> None:
    """Written beside and renamed: a file that exists is whole."""
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps(result, separators=(",", ":")))
    beside.replace(path)


def success_cells(
    scenarios: Iterable[str], methods: Iterable[str], counts: Iterable[int], sets: int, runs: int
) -> list[Cell]:
    """Every task learned from sets of demonstrations of several sizes, by an expert and in a real cell.

    NOMINAL, which needs no learning of its own, stands for comparison beside the expert's fewest demonstrations only.
    Trees of our method run twice as often as `runs`, since a single failure should not decide on a set.
    """
    methods, counts = tuple(methods), tuple(counts)
    return [
        Cell("success", name, method, users, count, number, runs * (2 if method == "treewright" else 1))
        for name in scenarios
        for users in ("expert", "real")
        for method in methods
        for count in sorted({max(count, SCENARIOS[name].least) for count in counts})
        for number in range(sets)
        if method != NOMINAL or (users == "expert" and count <= max(min(counts), SCENARIOS[name].least))
    ]


def user_cells(methods: Iterable[str], sets: int, runs: int) -> list[Cell]:
    """The fourteen alone, three demonstrations each; the first twelve and all of them pooled."""
    groups = [*(user.name for user in FOURTEEN), "pooled", "all"]
    return [
        Cell("users", "tower_and_box", method, users, 3, number, runs)
        for users in groups
        for method in methods
        for number in range(sets)
    ]


def size_cells(methods: Iterable[str], counts: Iterable[int]) -> list[Cell]:
    """Kitting from more and more demonstrations: the tree's size and the time to learn it."""
    return [
        Cell("size", scenario, method, "expert", count, 0, 0)
        for scenario in ("kitting4", "kitting6")
        for method in methods
        for count in counts
    ]
