"""Trees made wrong on purpose, to see whether the proof has teeth: a leaf deleted, or two neighbours swapped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from learner.model import Node, Tree
from learner.model.tree import RECOVERY_PREFIX
from learner.proof import AbstractWorld, States, Ticks, every_state, prove

SAMPLE = 4000
"""So many states of the sound tree tell whether a mutant behaves otherwise."""


@dataclass(frozen=True)
class Teeth:
    """How many mutants behave otherwise than the sound tree, and how many of those the proof refuses."""

    different: int
    caught: int

    @property
    def share(self) -> float:
        return self.caught / self.different if self.different else 1.0


def mutants(root: Node) -> Iterator[Node]:
    """Every tree with one leaf deleted, or with two neighbouring children swapped."""
    for number, child in enumerate(root.children):
        if not child.children and len(root.children) > 1:
            yield _with(root, (*root.children[:number], *root.children[number + 1 :]))
        if number + 1 < len(root.children):
            following = root.children[number + 1]
            yield _with(root, (*root.children[:number], following, child, *root.children[number + 2 :]))
        for changed in mutants(child):
            yield _with(root, (*root.children[:number], changed, *root.children[number + 1 :]))


def _with(node: Node, children: tuple[Node, ...]) -> Node:
    return replace(node, children=children)


def mutated(tree: Tree) -> Iterator[Tree]:
    """Every mutant of the main tree and of the SubTrees that do not only recover; uses of SubTrees are leaves."""
    for definition in tree.definitions.values():
        if definition.id.startswith(RECOVERY_PREFIX):
            continue
        for root in mutants(definition.root):
            changed = replace(definition, root=root)
            if definition == tree.main:
                yield Tree(changed, tree.subtrees)
            else:
                others = tuple(other for other in tree.subtrees if other != definition)
                yield Tree(tree.main, (*others, changed))


def teeth(tree: Tree, base_frame: str) -> Teeth:
    """Prove every mutant of a tree that behaves otherwise in the sound tree's own world.

    Raises ValueError if the tree itself is not proven: then nothing would be shown.
    """
    root = tree.flattened()
    if prove(tree, base_frame, np.random.default_rng(0)).counterexample:
        raise ValueError(f"the tree {tree.main.id} is not sound itself")
    world = AbstractWorld(root, base_frame)
    states = _some(every_state(world))
    sound = _decisions(world, root, states)
    different = caught = 0
    for mutant in mutated(tree):
        if _decisions(world, mutant.flattened(), states) == sound:
            continue
        different += 1
        caught += prove(mutant, base_frame, np.random.default_rng(0), root).counterexample is not None
    return Teeth(different, caught)


def _some(states: States) -> States:
    return states.take(slice(None, None, max(1, len(states) // SAMPLE)))


def _decisions(world: AbstractWorld, root: Node, states: States) -> list[tuple[int, Node | None]]:
    ticks = Ticks(world, states, root)
    chosen = [ticks.chosen[number] if number >= 0 else None for number in ticks.action]
    return [(int(status), node) for status, node in zip(ticks.status, chosen, strict=True)]
