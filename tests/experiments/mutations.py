"""Trees made wrong on purpose, to see whether the proof has teeth: a leaf deleted, or two neighbours swapped.

A mutant counts if it behaves otherwise than the sound tree in any state of the sound tree's world. Not every such
tree is worse: the order in which a box is filled can be of no account. So what the proof lets pass is looked at twice.
A mutant is as good if, over all states, it needs no more actions than the sound tree, at most and on average, and if
in the kinematic world, in the same runs with everything that happens to robots, it fails in at most one in a hundred
more. Any other is worse, and the proof has missed it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from learner.model import Node, Tree
from learner.model.vocabulary import RECOVERY_PREFIX
from learner.proof.abstract_world import AbstractWorld, Ints, States
from learner.proof.prover import RUNNING, SUCCESS, Arena, Program, Ticks
from learner.relations.things import NO_THINGS, Things

MOST_ALIKE: Final = 60_000
"""Whether a mutant behaves otherwise is looked at in at most so many states, evenly taken from all of them."""
FIRST_LOOK: Final = 2_000
"""Most wrong trees are refuted from the first few states."""
MOST_ACTIONS: Final = 200
SAME_ACTIONS: Final = 1.01
"""A mutant that needs less than one action in a hundred more on average needs no more."""
MORE_FAILURES: Final = 0.01

Trial = Callable[[Node], tuple[int, int]]
"""How many of a fixed set of runs a flattened tree fails, and how many there are."""


@dataclass(frozen=True)
class Mutant:
    """A tree made wrong, and what was done to it, in words."""

    tree: Tree
    change: str


@dataclass(frozen=True)
class Passed:
    """A mutant that the proof lets pass: actions over all states, and failed runs, beside the sound tree's."""

    change: str
    most_actions: tuple[int, int]
    mean_actions: tuple[float, float]
    failed: tuple[int, int]
    runs: int

    @property
    def as_good(self) -> bool:
        """Whether it is no worse than the sound tree, neither in the abstract world nor in the runs."""
        (most, most_sound), (mean, mean_sound) = self.most_actions, self.mean_actions
        failed, failed_sound = self.failed
        fails_alike = failed <= failed_sound + MORE_FAILURES * self.runs
        return most <= most_sound and mean <= SAME_ACTIONS * mean_sound and fails_alike

    def __str__(self) -> str:
        (most, most_sound), (mean, mean_sound) = self.most_actions, self.mean_actions
        return (
            f"{self.change}: {mean:.2f} actions ({most} at most) instead of {mean_sound:.2f} ({most_sound}), "
            f"{self.failed[0]} of {self.runs} runs failed instead of {self.failed[1]}"
        )


@dataclass(frozen=True)
class Teeth:
    """How many mutants were made, how many behave otherwise, how many of those the proof refuses, and the others."""

    made: int
    different: int
    passed: tuple[Passed, ...] = field(default=())

    @property
    def caught(self) -> int:
        return self.different - len(self.passed)

    @property
    def missed(self) -> list[Passed]:
        """Those that are worse than the sound tree and yet pass."""
        return [one for one in self.passed if not one.as_good]

    @property
    def share(self) -> float:
        """The share of the worse ones that are refused."""
        worse = self.caught + len(self.missed)
        return self.caught / worse if worse else 1.0


def mutants(root: Node, within: str) -> Iterator[tuple[Node, str]]:
    """Every tree with one leaf deleted, or with two neighbouring children swapped."""
    for number, child in enumerate(root.children):
        before, after = root.children[:number], root.children[number + 1 :]
        if not child.children and len(root.children) > 1:
            yield replace(root, children=(*before, *after)), f"{within}: {_word(child)} deleted"
        if after:
            swapped = (*before, after[0], child, *after[1:])
            yield replace(root, children=swapped), f"{within}: {_word(child)} and {_word(after[0])} swapped"
        for changed, change in mutants(child, within):
            yield replace(root, children=(*before, changed, *after)), change


def mutated(tree: Tree, recovery: bool) -> list[Mutant]:
    """Every mutant of the main tree and its SubTrees, or of those that only recover; uses of SubTrees are leaves."""
    found = []
    for definition in tree.definitions.values():
        if definition.id.startswith(RECOVERY_PREFIX) == recovery:
            for root, change in mutants(definition.root, definition.id):
                changed = replace(definition, root=root)
                others = tuple(other for other in tree.subtrees if other != definition)
                main = definition == tree.main
                found.append(
                    Mutant(Tree(changed, tree.subtrees) if main else Tree(tree.main, (*others, changed)), change)
                )
    return found


def teeth(
    tree: Tree,
    base_frame: str,
    failures: Trial,
    recovery: bool = False,
    most: int | None = None,
    rng: np.random.Generator | None = None,
    things: Things = NO_THINGS,
) -> Teeth:
    """Prove mutants of a tree that behave otherwise in the sound tree's own world: all, or `most` drawn at random.

    Raises ValueError if the tree itself is not proven: then nothing would be shown.
    """
    judge = _Judge(tree, base_frame, failures, things)
    made = mutated(tree, recovery)
    if most is not None and len(made) > most:
        drawn = (rng or np.random.default_rng(0)).permutation(len(made))[:most]
        made = [made[number] for number in np.sort(drawn)]
    different = [mutant for mutant in made if judge.is_different(mutant.tree.flattened())]
    passed = [judge.passed(mutant) for mutant in different if judge.proves(mutant.tree.flattened())]
    return Teeth(len(made), len(different), tuple(passed))


class _Judge:
    """Compares mutants with the sound tree."""

    def __init__(self, tree: Tree, base_frame: str, failures: Trial, things: Things) -> None:
        self.root, self.failures = tree.flattened(), failures
        self.arena = Arena(AbstractWorld(base_frame, self.root, levels=5, things=things), np.random.default_rng(0))
        if self.arena.prove(self.root).counterexample:
            raise ValueError(f"the tree {tree.main.id} is not sound itself")
        self.few = self.arena.among(_evenly(self.arena.starts, FIRST_LOOK))
        self.some = _evenly(self.arena.starts, MOST_ALIKE)
        self.numbers: dict[Node, int] = {}
        self.decisions = self._decisions(self.root)

    def is_different(self, root: Node) -> bool:
        """Whether it says or does anything else in any of some states."""
        return not np.array_equal(self._decisions(root), self.decisions)

    def _decisions(self, root: Node) -> Ints:
        """For each of some states the status, and the number of the action begun (0: none)."""
        program = Program(root)
        ticks = [
            Ticks(self.arena.world, states, program) for states in self.some.chunks(self.arena.world.parameters.chunk)
        ]
        numbers = [self.numbers.setdefault(leaf, len(self.numbers) + 1) for leaf in program.leaves]
        known = np.array([*numbers, 0])
        return np.concatenate([np.stack([tick.status, known[tick.action]]) for tick in ticks], axis=1)

    def proves(self, root: Node) -> bool:
        """Whether the proof lets it pass."""
        return not any(arena.prove(root, self.root).counterexample for arena in (self.few, self.arena))

    def passed(self, mutant: Mutant) -> Passed:
        """It beside the sound tree, in the abstract world and in the runs."""
        root = mutant.tree.flattened()
        ours, sound = self._actions(root), self._actions(self.root)
        (failed, runs), (failed_sound, _) = self.failures(root), self.failures(self.root)
        most, mean = (int(ours.max()), int(sound.max())), (float(ours.mean()), float(sound.mean()))
        return Passed(mutant.change, most, mean, (failed, failed_sound), runs)

    def _actions(self, root: Node) -> Ints:
        """How many actions a proven tree needs from each of some states."""
        program = Program(root)
        return np.concatenate(
            [
                _actions(self.arena.world, program, states)
                for states in self.some.chunks(self.arena.world.parameters.chunk)
            ]
        )


def _actions(world: AbstractWorld, program: Program, states: States) -> Ints:
    needed, left = np.full(len(states), MOST_ACTIONS), np.arange(len(states))
    for count in range(MOST_ACTIONS):
        ticks = Ticks(world, states, program)
        needed[left[ticks.status == SUCCESS]] = count
        runs = ticks.status == RUNNING
        if not runs.any():
            break
        left, states = left[runs], ticks.successors()[0].take(slice(int(runs.sum())))
    return needed


def _evenly(states: States, count: int) -> States:
    return states.take(slice(None, None, max(1, len(states) // count)))


def _word(node: Node) -> str:
    ports = dict(node.ports)
    words = [str(ports[name]) for name in ("object", "frame", "state") if name in ports]
    inner: Sequence[Node] = [] if words or node.id else [below for below in node.walk() if not below.children][:1]
    return " ".join([node.id or node.kind, *words, *(f"of {_word(below)}" for below in inner)])
