"""The shop's tasks, learned as they are published and run: does it work, is false success said, and what is doubted?

found = compute_shop(ShopCell("station", 3, 0))
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from learner.errors import LearnerError
from learner.execution.ticking import Status, Ticker
from learner.learned import Learned
from learner.learning import learn
from learner.model import Demonstration, Node, Scene
from learner.observation import observe
from learner.relations.grasping import Grasp
from learner.relations.knowledge import Knowledge
from learner.simulation.gravity import Body, Spot
from learner.simulation.kinematic_world import PERIOD_S, WORKSPACE_M, KinematicWorld, Noise
from pipelines.steps.gate import reasons_against

from .demonstrator import demonstrate
from .report import grouped, table
from .scenarios import Scenario, Start
from .shop_tasks import SHOP, Course, Script, ShopTask, is_possible, start_of
from .users import EXPERT, User

RUNS: Final = 10
"""Calm runs of each tree, and as many disturbed ones."""
COUNTS: Final = (3, 10)
SETS: Final = 2
HOLD_STEPS: Final = round(1.0 / PERIOD_S)
STEPS_PER_ACTION: Final = 7
FINE_RAD: Final = math.radians(0.3)
"""What a cell that tells its accuracy scatters in angle."""
WORKS: Final = 0.9
"""A tree that does a task in a smaller share of its calm runs is wrong."""
HEAD: Final = ("task", "it takes", "demonstrations", "calm", "disturbed", "false success", "said", "nodes", "recovery",
               "seconds")  # fmt: skip
Result = dict[str, Any]


@dataclass(frozen=True)
class ShopCell:
    """A task, learned from so many demonstrations, the set of that number."""

    task: str
    demonstrations: int
    number: int
    rehearsed: bool = True
    runs: int = RUNS

    @property
    def key(self) -> str:
        return f"shop-{self.task}-{self.demonstrations}-{self.number}-{self.runs}" + "-plain" * (not self.rehearsed)


@dataclass(frozen=True)
class _Given(Scenario):
    """A scenario with one start and one script, which the demonstrator takes as they are."""

    accuracy_m: float | None = None

    def draw_start(self, rng: np.random.Generator, script: Script | None = None, tries: int = 0) -> dict[str, Spot]:
        return dict(self.start.fixed or {})

    @property
    def scene(self) -> Scene:
        shapes = {name: body.shape for name, body in self.objects.items()}
        return Scene(shapes, WORKSPACE_M, self.accuracy_m)


def shop_cells(names: Iterable[str], counts: Sequence[int], sets: int, runs: int) -> list[ShopCell]:
    """Each task from so many demonstrations, so many sets of each."""
    return [ShopCell(name, count, number, runs=runs) for name in names for count in counts for number in range(sets)]


def shown(task: ShopTask, count: int, seed: int) -> list[Demonstration]:
    """Demonstrations of a task, as a cell records and ingest observes them."""
    rng = np.random.default_rng([seed, count])
    return [_demonstrated(task, rng, number) for number in range(count)]


def _demonstrated(task: ShopTask, rng: np.random.Generator, number: int) -> Demonstration:
    while True:
        start = start_of(task, rng)
        script = task.script(start, rng)
        if not is_possible(task, start, script) or task.done(Course(start, start)):
            continue
        user = EXPERT if task.accuracy_m is None else User("fine", task.accuracy_m, FINE_RAD, camera_m=task.accuracy_m)
        given = _Given(task.name, task.objects, (script,), ((),), Start(fixed=start), accuracy_m=task.accuracy_m)
        try:
            return observe(demonstrate(given, rng, user, number))
        except RuntimeError:
            continue


def compute_shop(cell: ShopCell) -> Result:
    """Demonstrate, learn as `treewright learn` does, run."""
    task = SHOP[cell.task]
    demonstrations = sorted(shown(task, cell.demonstrations, cell.number), key=lambda d: d.demonstration_id)
    begin = time.perf_counter()
    try:
        learned = learn(demonstrations, rehearsed=cell.rehearsed)
    except LearnerError as error:
        return {**asdict(cell), "refused": str(error)}
    seconds = time.perf_counter() - begin
    root = learned.tree.flattened()
    return {
        **asdict(cell), **_told(learned), "seconds": round(seconds, 2), "nodes": learned.tree.nodes,
        "recovery": root.size - learned.tree.nodes,
        "calm": _verdicts(task, root, cell, False, learned.grasps),
        "disturbed": _verdicts(task, root, cell, True, learned.grasps),
    }  # fmt: skip


def _told(learned: Learned) -> Result:
    """What is doubted, asked, or speaks against the tree."""
    return {
        "doubts": sorted({doubt.what for doubt in learned.doubts}),
        "questions": len(learned.report.get("questions", ())),
        "against": list(reasons_against(learned, ())),
        "sentences": [doubt.sentence for doubt in learned.doubts],
    }


def _verdicts(task: ShopTask, root: Node, cell: ShopCell, disturbed: bool, grasps: Sequence[Grasp]) -> Counter[str]:
    """How often each verdict came."""
    seeds = ([cell.number, number, int(disturbed)] for number in range(cell.runs))
    return Counter(run_shop(task, root, np.random.default_rng([7, *seed]), disturbed, grasps) for seed in seeds)


def run_shop(
    task: ShopTask, root: Node, rng: np.random.Generator, disturbed: bool = False, grasps: Sequence[Grasp] = ()
) -> str:
    """One run from a start in which the task can be done and is not; the verdict as in `runner`."""
    while True:
        start = start_of(task, rng, strangers=True)
        own = {name: spot for name, spot in start.items() if name in task.objects}
        script = task.script(own, rng)
        if is_possible(task, own, script) and not task.done(Course(start, start)):
            knowledge = Knowledge.of(root, grasps)
            return _Run(task, root, start, len(script), rng, disturbed, knowledge).verdict()


@dataclass
class _Run:
    """A run under way."""

    task: ShopTask
    root: Node
    start: Mapping[str, Spot]
    moves: int
    rng: np.random.Generator
    disturbed: bool
    knowledge: Knowledge
    rested: list[tuple[str, Mapping[str, Spot]]] = field(default_factory=list)

    def verdict(self) -> str:
        """Tick until the tree says SUCCESS for a second, or has had three times the actions of the script and four."""
        bodies: dict[str, Body] = {**self.task.objects, **self.task.strangers}
        noise = Noise() if self.task.accuracy_m is None else Noise(self.task.accuracy_m, FINE_RAD)
        world = KinematicWorld(bodies, self.start, self.rng, noise, knowledge=self.knowledge)
        ticker, limit, said, held = Ticker(self.root, world), 6 * self.moves + 4, 0, world.held
        due = int(self.rng.integers(1, 2 * self.moves * STEPS_PER_ACTION)) if self.disturbed else -1
        for step in range(2 * limit * STEPS_PER_ACTION):
            if step == due:
                self._disturb(world)
            said = said + 1 if ticker.tick() is Status.SUCCESS else 0
            world.step()
            if held and held != world.held:
                self.rested.append((held, dict(world.table.spots)))
            held = world.held
            if len(world.attempts) > limit:
                return "too many actions"
            if said >= HOLD_STEPS and step > due + HOLD_STEPS:
                done = held is None and self.task.done(Course(self.start, world.table.spots, self.rested))
                return "done" if done else "false success"
        return "no progress"

    def _disturb(self, world: KinematicWorld) -> None:
        """What the script moves, and is free, is laid elsewhere."""
        names = sorted(n for n, body in self.task.objects.items() if body.graspable and n != world.held
                       and not body.shape.fixed and not world.table.covered(n))  # fmt: skip
        if names:
            name = str(self.rng.choice(names))
            free = start_of(self.task, self.rng)
            world.lay(name, free[name])


def _is_said(result: Result) -> bool:
    return bool(result["doubts"] or result["questions"] or result["against"])


def is_silently_wrong(result: Result) -> bool:
    """Whether a tree does not work and nothing tells: no doubt, no question, no failed rehearsal."""
    if "refused" in result:
        return False
    return not _is_said(result) and result["calm"].get("done", 0) < WORKS * result["runs"]


def shop_table(results: Sequence[Result]) -> str:
    """A row a task and number of demonstrations; below, what is wrong and not said."""
    rows = [_row(task, count, found) for (task, count), found in grouped(results, "task", "demonstrations").items()]
    silent = [f"- {r['task']}, {r['demonstrations']} demonstrations, set {r['number']}: {dict(r['calm'])}"
              for r in results if is_silently_wrong(r)]  # fmt: skip
    return "\n\n".join([table(HEAD, rows), "Wrong, and not said:", "\n".join(silent) or "None."])


def _row(task: str, count: int, results: Sequence[Result]) -> tuple[object, ...]:
    learned = [result for result in results if "refused" not in result]
    if not learned:
        return (task, SHOP[task].needs, count, "-", "-", "-", "refused", "-", "-", "-")
    runs = sum(result["runs"] for result in learned)
    calm, disturbed = (sum((Counter(r[kind]) for r in learned), Counter[str]()) for kind in ("calm", "disturbed"))
    false = calm["false success"] + disturbed["false success"]
    return (
        task, SHOP[task].needs, count, f"{calm['done']} of {runs}", f"{disturbed['done']} of {runs}",
        f"{false} of {2 * runs}", ", ".join(sorted(set(_words(learned)))) or "nothing",
        max(r["nodes"] for r in learned), max(r["recovery"] for r in learned),
        f"{max(r['seconds'] for r in learned):.1f}",
    )  # fmt: skip


def _words(results: Sequence[Result]) -> Iterator[str]:
    for result in results:
        yield from result["doubts"]
        yield from (["a question"] if result["questions"] else [])
        yield from (["it fails when tried"] if result["against"] else [])
