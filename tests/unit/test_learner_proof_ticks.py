"""The proof's tick of many states says and does what the Ticker does in each; its states are counted again."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from learner.execution.ticking import Status, Ticker
from learner.learning import learn
from learner.model import (
    Drop,
    GripperIs,
    InGripper,
    Node,
    ObjectAt,
    ObjectRoughlyAt,
    Pick,
    Place,
    SetGripper,
)
from learner.model.names import NONE
from learner.model.tree import leaf, sequence
from learner.model.vocabulary import DECORATORS, FALLBACKS, SEQUENCES
from learner.proof.abstract_world import AWAY, FIRST_LOCATION, HELD, AbstractWorld, States
from learner.proof.prover import NOTHING, Arena, Keys, Program, Ticks

DOWN = (1.0, 0.0, 0.0, 0.0)
ZERO = (0.0, 0.0, 0.0)
UPON = (0.0, 0.0, 0.05)
BESIDE = (0.0, 0.12, 0.0)
ON_TABLE = (0.4, 0.1, 0.025)
STATUSES = {0: Status.FAILURE, 1: Status.RUNNING, 2: Status.SUCCESS}

WORDS = (
    GripperIs("open"),
    GripperIs("closed"),
    InGripper(NONE),
    *(InGripper(name) for name in "ABC"),
    *(ObjectAt(a, b, UPON, 0.03) for a in "ABC" for b in "ABC" if a != b),
    ObjectAt("A", "B", BESIDE, 0.03),
    ObjectAt("B", "base", ON_TABLE, 0.03),
    ObjectRoughlyAt("C", "box", ZERO, 0.1),
    SetGripper("open"),
    SetGripper("closed"),
    *(Pick(name, name, ZERO, DOWN) for name in "ABC"),
    *(Place(a, b, UPON, DOWN, UPON) for a, b in ("AB", "BC", "CA")),
    Place("A", "B", BESIDE, DOWN, BESIDE),
    Place("B", "base", ON_TABLE, DOWN, ON_TABLE),
    Drop("C", "box", ZERO, DOWN, ZERO),
)
WORLD = AbstractWorld("base", sequence(*map(leaf, WORDS)), levels=5)
EVERY, _ = WORLD.states(np.random.default_rng(0))


def composites(children: st.SearchStrategy[Node]) -> st.SearchStrategy[Node]:
    below = st.lists(children, min_size=1, max_size=4).map(tuple)
    composite = st.builds(lambda kind, nodes: Node(kind, (), nodes), st.sampled_from([*SEQUENCES, *FALLBACKS]), below)
    decorator = st.builds(lambda kind, node: Node(kind, (), (node,)), st.sampled_from(DECORATORS), children)
    return st.one_of(composite, composite, decorator)


TREES = st.recursive(st.sampled_from(WORDS).map(leaf), composites, max_leaves=15)


class OneState:
    """A world of learner.execution.ticking in one abstract state, in which time stands still."""

    def __init__(self, states: States) -> None:
        self.states, self.layout = states, WORLD.layout(states)
        self.begun: Node | None = None

    def check(self, node: Node) -> bool:
        return bool(WORLD.holds(node, self.states, self.layout)[0])

    def tick_action(self, node: Node) -> Status:
        can = bool(WORLD.can(node, self.states, self.layout)[0])
        self.begun = node if can else self.begun
        return Status.RUNNING if can else Status.FAILURE

    def halt_action(self, node: Node) -> None:
        """A first tick halts nothing."""
        raise AssertionError(node)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(TREES, st.lists(st.integers(0, len(EVERY) - 1), min_size=1, max_size=8))
def test_many_states_at_once_are_ticked_as_each_alone_by_the_interpreter(root: Node, columns: list[int]) -> None:
    program = Program(root)
    ticks = Ticks(WORLD, EVERY, program)
    for column in columns:
        world = OneState(EVERY.take([column]))
        assert Ticker(root, world).tick() is STATUSES[int(ticks.status[column])]
        action = ticks.action[column]
        assert world.begun == (program.leaves[action] if action != NOTHING else None)


@settings(max_examples=50, deadline=None)
@given(TREES)
def test_an_action_is_begun_where_and_only_where_a_tree_runs_and_leads_to_a_state_that_can_be(root: Node) -> None:
    keys = Keys(WORLD)
    ticks = Ticks(WORLD, EVERY, Program(root))
    following, source = ticks.successors()
    assert np.array_equal(ticks.status == 1, ticks.action != NOTHING)
    assert set(source) == set(np.flatnonzero(ticks.status == 1))
    assert np.isin(keys.of(following), keys.of(EVERY)).all()


def test_keys_of_bytes_tell_the_same_states_apart_as_numbers() -> None:
    numbers, letters = Keys(WORLD), Keys(WORLD)
    letters.fits = False
    assert numbers.fits
    doubled = States.joined([EVERY, EVERY.take(slice(0, 50))])
    assert len(numbers.fresh(doubled)) == len(letters.fresh(doubled)) == len(EVERY)
    assert len(numbers.fresh(EVERY)) == len(letters.fresh(EVERY)) == 0
    order = np.argsort(letters.of(EVERY))
    assert (np.diff(numbers.of(EVERY)[order]) > 0).all()


def possible(locations: tuple[int, ...], closed: bool) -> bool:
    """One state, looked at alone: what the docstring of AbstractWorld.states says, in plain words."""
    at = dict(zip(WORLD.objects, locations, strict=True))
    held = [name for name, location in at.items() if location == HELD]
    if len(held) > 1 or (held and not closed):
        return False
    chains = {name: chain(name, at) for name in at}
    if any(links is None for links in chains.values()):
        return False
    spots = {name: spot(name, links, at) for name, links in chains.items() if links is not None}
    for a, b in product(at, at):
        if a != b and spots[a][0] == spots[b][0] and np.linalg.norm(spots[a][1] - spots[b][1]) < 0.03:
            return False
        if a != b and b in held and spots[a][0] == b:
            return False
    return not any(hangs(name, at, chains, spots) for name in at)


def chain(name: str, at: dict[str, int]) -> list[str] | None:
    """The objects from one on down to that in whose place it ends; None if that is a circle."""
    links = [name]
    while at.get(links[-1], AWAY) >= FIRST_LOCATION:
        links.append(WORLD.locations[links[-1]][at[links[-1]] - FIRST_LOCATION].frame)
        if links[-1] in links[:-1]:
            return None
    return links


def spot(name: str, links: list[str], at: dict[str, int]) -> tuple[str, np.ndarray]:
    steps = [WORLD.locations[link][at[link] - FIRST_LOCATION].position for link in links[:-1]]
    return links[-1], np.sum([ZERO, *steps], axis=0)


def hangs(name: str, at: dict[str, int], chains: dict, spots: dict) -> bool:
    """A lies beside B, which lies upon another, and nothing is beneath A."""
    if at[name] < FIRST_LOCATION or WORLD.locations[name][at[name] - FIRST_LOCATION].position != BESIDE:
        return False
    links = chains[name][1:-1]
    raised = any(WORLD.locations[link][at[link] - FIRST_LOCATION].position == UPON for link in links)
    root, here = spots[name]
    apart = [here - there for its_root, there in spots.values() if its_root == root]
    below = [offset for offset in apart if 0.02 < offset[2] < 0.08 and np.hypot(*offset[:2]) < 0.05]
    return raised and not below


def test_the_states_are_those_that_can_be_counted_one_by_one() -> None:
    one_by_one = {
        (locations, closed)
        for locations in product(*(range(size) for size in WORLD.sizes))
        for closed in (False, True)
        if possible(locations, closed)
    }
    found = {(tuple(map(int, EVERY.locations[:, n])), bool(EVERY.closed[n])) for n in range(len(EVERY))}
    assert len(found) == len(EVERY) > 90
    assert found == one_by_one


@pytest.mark.parametrize("name", ["tower_and_box", "moving_reference", "two_goals", "board"])
def test_a_proven_tree_needs_as_many_actions_as_it_does_from_the_table(name: str) -> None:
    """A pick and a release for each placement of the goal."""
    scenario = SCENARIOS[name]
    root = learn(demonstrated(scenario, scenario.least, 31)).tree.flattened()
    arena = Arena(AbstractWorld("base", root, levels=5), np.random.default_rng(0))
    on_table = ((arena.starts.locations == AWAY).all(axis=0)) & ~arena.starts.closed
    few = arena.among(arena.starts.take(on_table))
    proven = few.prove(root)
    assert (proven.states, proven.counterexample) == (1, None)
    assert proven.bound == 2 * len(scenario.goals[0])
