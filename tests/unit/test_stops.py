"""Steps on the way: what most demonstrations visit is learned, proven, run in order, and again after a failure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import groupby

import numpy as np
import pytest
from support_btcpp import CppTicker
from support_demonstrations import BASE, ON_TOP, Put, Script, at, repeated, scattered, scripted

from learner.execution.engine import Engine
from learner.execution.entries import Found
from learner.execution.ticking import Leaves, Status, Ticker
from learner.learned import Learned
from learner.learning import learn
from learner.model import Definition, Demonstration, Node, ObjectShape, Scene, Tree
from learner.proof.abstract_world import NOTHING, AbstractWorld, States
from learner.proof.prover import Program, Ticks, prove
from learner.rehearsal.goal import Relation, goals_of, holds
from learner.rehearsal.rehearsal import rehearse
from learner.rehearsal.stage import Stage
from learner.simulation.kinematic_world import KinematicWorld

CUBE = ObjectShape((0.05, 0.05, 0.05), "cube")
FLAT = ObjectShape((0.2, 0.12, 0.02), "none", fixed=True)
UPON = (0.0, 0.0, 0.035)
NAMES = ("A", "washer", "dryer", "tray")
SCENE = Scene({name: CUBE if name == "A" else FLAT for name in NAMES}, ((0.15, 0.85), (-0.55, 0.55)))
WASHED = (Put("A", "washer", UPON), Put("A", "tray", UPON))
WASHED_AND_DRIED = (Put("A", "washer", UPON), Put("A", "dryer", UPON), Put("A", "tray", UPON))
UNWASHED = (Put("A", "tray", UPON),)
Make = Callable[[Node, Leaves], Ticker | Engine | CppTicker]


def shown(scripts: Sequence[Script], seed: int = 0, users: Sequence[str] = ("u1",)) -> list[Demonstration]:
    return repeated(NAMES, scripts, seed, SCENE, users)


def stops(learned: Learned) -> list[str]:
    return [stop for group in learned.report["groups"] for stop in group.get("stops", ())]


def visits_doubted(learned: Learned) -> list[str]:
    return [doubt.sentence for doubt in learned.doubts if doubt.what == "visit"]


@pytest.mark.parametrize("count", [3, 10])
@pytest.mark.parametrize(
    ("script", "expected"),
    [(WASHED, ["A at washer"]), (WASHED_AND_DRIED, ["A at washer", "A at dryer"])],
    ids=["one station", "two stations"],
)
def test_what_all_demonstrations_visit_is_learned_in_order_and_proven(
    script: Script, expected: list[str], count: int
) -> None:
    for seed in range(2):
        learned = learn(shown([script] * count, seed))
        assert stops(learned) == expected
        assert not learned.doubts
        assert learned.certificate is not None
        assert learned.certificate["counterexample"] is None


@pytest.mark.parametrize("washed", [2, 4, 5])
def test_what_no_majority_visits_is_a_correction(washed: int) -> None:
    learned = learn(shown([WASHED] * washed + [UNWASHED] * (10 - washed)))
    assert stops(learned) == []
    assert not learned.doubts
    assert sum("moved again at once" in note for note in learned.notes) == washed


def test_who_left_out_what_most_visit_is_told() -> None:
    learned = learn(shown([WASHED] * 8 + [UNWASHED] * 2))
    assert stops(learned) == ["A at washer"]
    assert [note for note in learned.notes if "did not bring A to washer" in note] == [
        f"demonstration {name} did not bring A to washer; the tree does, as the others" for name in ("d008", "d009")
    ]


def test_a_habit_of_one_of_several_users_is_no_step_of_the_task() -> None:
    learned = learn(shown([WASHED, UNWASHED, UNWASHED] * 4, users=("u1", "u2", "u3")))
    assert stops(learned) == []


def test_what_is_set_down_badly_and_put_right_by_all_is_no_stop() -> None:
    near = (Put("A", "tray", (0.03, 0.02, 0.035)), Put("A", "tray", UPON))
    learned = learn(shown([near] * 6))
    assert [group["goal"] for group in learned.report["groups"]] == [["A at tray"]]
    assert stops(learned) == []
    assert not learned.doubts


def test_a_tool_that_goes_back_to_where_it_began_is_said_to_have_been_elsewhere() -> None:
    rng, shows = np.random.default_rng(0), []
    for number in range(4):
        start = {**scattered(NAMES, rng), "A": at(0.9, 0.0)}
        script = (Put("A", "washer", UPON), Put("A", BASE, (0.9, 0.0, 0.025)))
        shows.append(scripted(start, script, f"d{number}", rng=rng, scene=SCENE))
    learned = learn(shows)
    assert stops(learned) == []
    assert len(visits_doubted(learned)) == 1


def test_the_next_one_of_a_pile_is_washed_too() -> None:
    """Stops of two objects, one of which is built upon the other."""
    names, scene = ("A", "B", "washer", "tray"), Scene({**SCENE.objects, "B": CUBE}, SCENE.workspace_m)
    script = (*WASHED, Put("B", "washer", UPON), Put("B", "A", ON_TOP))
    learned = learn(repeated(names, [script] * 5, 1, scene))
    assert stops(learned) == ["A at washer", "B at washer"]
    assert not learned.doubts
    assert learned.certificate is not None
    assert learned.certificate["counterexample"] is None


@cache
def washed() -> tuple[Learned, tuple[Demonstration, ...]]:
    demonstrations = shown([WASHED_AND_DRIED] * 4, 3)
    return learn(demonstrations), tuple(demonstrations)


class Course:
    """A run of a tree in the kinematic world, in which the object is taken from the hand while it is being placed."""

    def __init__(self, make: Make, taken_before: str | None, learned: Learned, demonstrations: Sequence[Demonstration]):
        assert learned.draft
        stage, root = Stage(demonstrations), learned.tree.flattened()
        (goal,) = goals_of(learned.draft.understood.groups, learned.draft.placements, stage)
        ((end, on_the_way),) = goal.stops
        self.places: list[Relation] = [*on_the_way, end]
        here = stage.root(root)
        spots = stage.starts[0].spots
        self.aside = spots["A"]
        self.world: KinematicWorld = stage.world(
            spots, np.random.default_rng(1), knowledge=stage.knowledge(here, learned.grasps)
        )
        self.taken_before = taken_before
        self.ticker = make(here, self.world)

    def visited(self) -> list[str]:
        """Run to the end: by their frames the places at which the object lay, one after another."""
        seen: list[str] = []
        for _ in range(800):
            self._disturb()
            status = self.ticker.tick()
            seen += [place.frame for place in self.places if holds(place, self.world)][:1] or [""]
            if status is Status.SUCCESS and holds(self.places[-1], self.world):
                return [frame for frame, _ in groupby(seen) if frame]
            self.world.step()
        pytest.fail(f"not done; {self.world.attempts[-3:]}")

    def _disturb(self) -> None:
        last = self.world.attempts[-1] if self.world.attempts else None
        if last and (last.kind, last.frame) == ("Place", self.taken_before) and self.world.held and not last.ended:
            self.taken_before = None
            self.world.take_away(self.aside)


ENGINES: dict[str, Make] = {"interpreter": Ticker, "py_trees": Engine, "BehaviorTree.CPP": CppTicker}


@pytest.mark.parametrize(
    ("taken_before", "expected"),
    [
        (None, ["washer", "dryer", "tray"]),
        ("washer", ["washer", "dryer", "tray"]),
        ("dryer", ["washer", "washer", "dryer", "tray"]),
        ("tray", ["washer", "dryer", "washer", "dryer", "tray"]),
    ],
)
def test_three_engines_visit_the_stations_in_order_and_again_after_a_place_failed(
    taken_before: str | None, expected: list[str]
) -> None:
    runs = {name: Course(make, taken_before, *washed()) for name, make in ENGINES.items()}
    assert {name: run.visited() for name, run in runs.items()} == dict.fromkeys(ENGINES, expected)
    assert len({tuple(map(str, run.world.attempts)) for run in runs.values()}) == 1


def test_a_tree_that_passes_a_station_by_does_not_pass_its_rehearsal() -> None:
    learned, demonstrations = washed()
    straight = learn(shown([UNWASHED] * 4, 3))
    assert learned.draft
    stage = Stage(demonstrations)
    goals = goals_of(learned.draft.understood.groups, learned.draft.placements, stage)
    right = rehearse(learned.tree, stage, goals, grasps=learned.grasps)
    wrong = rehearse(straight.tree, stage, goals, grasps=straight.grasps)
    assert right.share.done == right.share.of > 0
    undisturbed = [result for result in wrong.results if result.rollout.event is None]
    assert undisturbed
    assert {result.judgement for result in undisturbed} == {"false success"}


class StepByStep:
    """The abstract world of the proof in one state, for the interpreter: an action ends at its second tick."""

    def __init__(self, world: AbstractWorld, states: States) -> None:
        self.world, self.states = world, states
        self.running: Node | None = None
        self.done: list[Node] = []

    def check(self, node: Node) -> bool:
        return bool(self.world.holds(node, self.states, self.world.layout(self.states))[0])

    def find(self, node: Node) -> Found | None:
        raise AssertionError(node)

    def tick_action(self, node: Node) -> Status:
        layout = self.world.layout(self.states)
        if not self.world.can(node, self.states, layout)[0]:
            return Status.FAILURE
        if self.running is not node:
            self.running = node
            return Status.RUNNING
        self.states, self.running = self.world.after(node, self.states, layout), None
        self.done.append(node)
        return Status.SUCCESS

    def halt_action(self, node: Node) -> None:
        self.running = None


@cache
def without_shapes() -> Node:
    """A tree without queries: shapes are not known. A goes by two stations, and B upon it by one."""
    script = (*WASHED_AND_DRIED, Put("B", "dryer", UPON), Put("B", "A", ON_TOP))
    return learn(repeated((*NAMES, "B"), [script] * 4, 2)).tree.flattened()


def test_the_proof_goes_on_after_each_action_as_the_interpreter_does() -> None:
    root = without_shapes()
    world = AbstractWorld(BASE, root, levels=5)
    program = Program(root)
    starts, whole = world.states(np.random.default_rng(0))
    assert whole
    longest = 0
    for column in range(len(starts)):
        real = StepByStep(world, starts.take([column]))
        ticker = Ticker(root, real)
        assert any(ticker.tick() is Status.SUCCESS for _ in range(60))
        states, proven = starts.take([column]), []
        while (ticks := Ticks(world, states, program)).action[0] != NOTHING:
            proven.append(program.leaves[ticks.action[0]])
            states = ticks.successors()[0].take([0])
        assert proven == real.done
        longest = max(longest, len(proven))
    assert longest >= 10


def test_what_is_left_again_is_proven_only_with_memory() -> None:
    assert refuted(without_shapes()) is None
    assert "never to the goal" in str(refuted(forgetful(without_shapes())))


def refuted(root: Node) -> str | None:
    return prove(Tree(Definition("t", root)), BASE, np.random.default_rng(0), levels=5).counterexample


def forgetful(node: Node) -> Node:
    """The same with reactive Sequences only."""
    kind = "ReactiveSequence" if node.kind == "Sequence" else node.kind
    return Node(kind, node.ports, tuple(map(forgetful, node.children)))
