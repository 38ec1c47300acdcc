"""The planner of the paper: backchaining in a simulator whose leaves fail once (section III-C, Colledanchise 2019).

From the goal conditions in a Sequence, the tree is run again and again. A condition that fails becomes
Fallback(condition, Sequence(preconditions of an action, action), ...) with the cheapest actions that achieve it; a
child of a Sequence whose actions undo what a sibling to its left has achieved moves before it.

Where the paper is silent, this planner does what the authors' published code does, unless noted:

- Of several actions that achieve a condition at the same lowest cost all become children of the Fallback, in the order
  in which they were demonstrated (in Colledanchise 2019: all actions). The positions among an action's preconditions
  are the context that it was learned in, and tell at run time which of them is done.
- What failed is expanded only if the whole tree failed by it, in each child of a failed Fallback.
- A condition on the gripper's state fails at its first tick. The published code takes that for a failure like any
  other; here such a leaf is expanded at once and alone, since nothing failed but by design. Otherwise the positions of
  a context that has passed would be expanded beside it, and the tree would go back to that context for ever.
- Conflicts are looked for in every Sequence, as in Colledanchise 2019, and two children change places only once. The
  published code looks at the topmost alone, and stops planning where changing places has no end.
- No action is prepared within its own preparation; the published code nests without bound.
- The published code's random starts and disturbances are left out: the paper does not speak of them. Starts were found
  to change nothing; disturbances make every alternative fail at once, and with the contexts that have passed expanded
  no tree for the tower of Hanoi works.
- Nothing is refused: a tree that does not reach its goal in the simulator is returned as it is after the last run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from learner.execution.ticking import Status
from learner.model import Action, Condition, GripperIs, InGripper, Node, SetGripper, compatible
from learner.model.names import NONE
from learner.model.tree import fallback, leaf, sequence
from learner.paper.pointworld import PointWorld

TICKS: Final = 100
"""A run ends after this many ticks (reference code)."""


@dataclass(frozen=True)
class Operator:
    """An action as the planner sees it: what must hold before it, in this order, what it brings about, its cost."""

    action: Action
    preconditions: tuple[Condition, ...]
    postconditions: frozenset[Condition]
    cost: float


@dataclass(frozen=True)
class PlannedTree:
    """A tree, and whether it reached its goal in the planner's simulator."""

    root: Node
    reached: bool


@dataclass(eq=False)
class _Leaf:
    """A condition or an action in the growing tree; `fails_once` is spent at the first tick."""

    word: Condition | Operator
    parent: _Branch | None = None
    fails_once: bool = False

    def node(self) -> Node:
        return leaf(self.word.action if isinstance(self.word, Operator) else self.word)


@dataclass(eq=False)
class _Branch:
    """A Sequence or Fallback in the growing tree."""

    is_sequence: bool
    children: list[_Leaf | _Branch] = field(default_factory=list)
    parent: _Branch | None = None

    def add(self, child: _Leaf | _Branch) -> None:
        child.parent = self
        self.children.append(child)

    def node(self) -> Node:
        if self.is_sequence and self.parent and len(self.children) == 1:
            return self.children[0].node()
        build = sequence if self.is_sequence else fallback
        return build(*(child.node() for child in self.children))


class Planner:
    """Grows one tree. Deterministic: equal goals and operators, in equal order, make equal trees."""

    def __init__(self, goals: Sequence[Condition], operators: Iterable[Operator], rollouts: int = 50) -> None:
        self.operators = list(operators)
        self.rollouts = rollouts
        self.world = PointWorld(_frames(goals, self.operators))
        self.root = _Branch(is_sequence=True)
        for goal in goals:
            self.root.add(_leaf(goal))
        self.failed: list[_Leaf] = []
        self.expanded = self.by_design = False
        self.moved: set[frozenset[int]] = set()

    def plan(self) -> PlannedTree:
        """The tree after the last run: the first in which nothing was expanded, since all others would be like it."""
        reached = False
        for _ in range(self.rollouts):
            self.expanded = False
            reached = self._run()
            if not self.expanded:
                break
        return PlannedTree(self.root.node(), reached)

    def _run(self) -> bool:
        """Tick from the beginning until the tree succeeds; false after too many ticks."""
        self.world.reset()
        for _ in range(TICKS):
            self.failed, self.by_design = [], False
            status = self._tick(self.root)
            if status is Status.SUCCESS:
                return True
            if status is Status.FAILURE and not self.by_design:
                self._expand(self.failed)
        return False

    def _tick(self, node: _Leaf | _Branch) -> Status:
        """Tick once. What an action brings about is seen at the next tick."""
        if isinstance(node, _Branch):
            return self._tick_branch(node)
        if not isinstance(node.word, Operator):
            return Status.SUCCESS if self._check(node, node.word) else Status.FAILURE
        self.world.do(node.word.action)
        return Status.RUNNING

    def _tick_branch(self, node: _Branch) -> Status:
        """A Sequence until a child does not succeed, a Fallback until one does not fail."""
        goes_on = Status.SUCCESS if node.is_sequence else Status.FAILURE
        for child in list(node.children):
            status = self._tick(child)
            if status is not goes_on:
                return status
        return goes_on

    def _check(self, node: _Leaf, condition: Condition) -> bool:
        """Whether a condition holds. If it does not and was not expanded yet, it is remembered."""
        if node.fails_once:
            node.fails_once, self.by_design = False, True
            self._expand([node])
            return False
        holds = self.world.holds(condition)
        if not holds and node.parent is not None and node.parent.is_sequence:
            self.failed.append(node)
        return holds

    def _expand(self, failed: Iterable[_Leaf]) -> None:
        for leaf_ in failed:
            achievers = self._achievers(leaf_)
            if achievers and leaf_.parent is not None:
                self.expanded = True
                self._give_way(self._put_choice(leaf_.parent, leaf_, achievers))

    def _achievers(self, failed: _Leaf) -> list[Operator]:
        """The cheapest actions that achieve the condition, of those that are not already being prepared above."""
        above = {id(child.word) for node in _upwards(failed) for child in node.children if isinstance(child, _Leaf)}
        fitting = [o for o in self.operators if failed.word in o.postconditions and id(o) not in above]
        return [o for o in fitting if o.cost == min(other.cost for other in fitting)]

    def _put_choice(self, parent: _Branch, failed: _Leaf, achievers: Iterable[Operator]) -> _Branch:
        choice = _Branch(is_sequence=False, parent=parent)
        parent.children[parent.children.index(failed)] = choice
        choice.add(failed)
        for operator in achievers:
            choice.add(_chain(operator))
        return choice

    def _give_way(self, choice: _Branch) -> None:
        """In every Sequence above, what undoes a sibling to its left comes before it."""
        child = choice
        for parent in _upwards(choice):
            if parent.is_sequence:
                self._reorder(parent, child)
            child = parent

    def _reorder(self, parent: _Branch, child: _Branch) -> None:
        """Move a child before the first sibling that it undoes; two that undo each other change places only once."""
        effects = _effects(child)
        for index, sibling in enumerate(parent.children[: parent.children.index(child)]):
            pair, wanted = frozenset({id(child), id(sibling)}), _wanted(sibling)
            if wanted and pair not in self.moved and any(not compatible(wanted, effect) for effect in effects):
                self.moved.add(pair)
                parent.children.remove(child)
                parent.children.insert(index, child)
                return


def _leaf(condition: Condition) -> _Leaf:
    return _Leaf(condition, fails_once=isinstance(condition, GripperIs))


def _chain(operator: Operator) -> _Branch:
    """Sequence(preconditions of an action, action)."""
    chain = _Branch(is_sequence=True)
    for precondition in operator.preconditions:
        chain.add(_leaf(precondition))
    chain.add(_Leaf(operator))
    return chain


def _upwards(node: _Leaf | _Branch) -> Iterator[_Branch]:
    """The branches above a node, from its parent to the root."""
    while node.parent is not None:
        node = node.parent
        yield node


def _wanted(node: _Leaf | _Branch) -> Condition | None:
    """The condition that a child of a Sequence checks or achieves; None for its action."""
    first = node.children[0] if isinstance(node, _Branch) else node
    return first.word if isinstance(first, _Leaf) and not isinstance(first.word, Operator) else None


def _effects(node: _Leaf | _Branch) -> set[Condition]:
    """The post-conditions of all actions from here down."""
    if isinstance(node, _Leaf):
        return set(node.word.postconditions) if isinstance(node.word, Operator) else set()
    return {effect for child in node.children for effect in _effects(child)}


def _frames(goals: Iterable[Condition], operators: Iterable[Operator]) -> set[str]:
    """Every object and frame that is spoken of."""
    words = [*goals, *(word for o in operators for word in (o.action, *o.preconditions))]
    found = {word.object for word in words if not isinstance(word, GripperIs | SetGripper)}
    framed = {word.frame for word in words if not isinstance(word, GripperIs | SetGripper | InGripper)}
    return (found | framed) - {NONE}
