"""The planner of the paper: backchaining in a world whose leaves fail (section III-C, after Colledanchise 2019).

From the goal conditions in a Sequence: a condition that fails becomes Fallback(condition, Sequence(preconditions of
an action, action)) for the cheapest action that achieves it; where an action undoes what a sibling to the left has
achieved, it moves before it. The world is abstract: its state is the set of conditions that hold.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from learner.errors import NothingLearnedError
from learner.model import Action, Condition, GripperIs, InGripper, Node, ObjectAt, ObjectRoughlyAt, compatible
from learner.model.names import NONE
from learner.model.tree import fallback, leaf, sequence


@dataclass(frozen=True)
class Operator:
    """An action as the planner sees it: what must hold before it, in this order, what it brings about, its cost."""

    action: Action
    preconditions: tuple[Condition, ...]
    postconditions: frozenset[Condition]
    cost: float


State = frozenset[Condition]
INITIAL: State = frozenset({GripperIs("open"), InGripper(NONE)})


def effects(operator: Operator, state: State) -> State:
    """The state after an action: its post-conditions, and what of the old state can hold beside them.

    An object that is picked up is no longer where it was.
    """
    held = {c.object for c in operator.postconditions if isinstance(c, InGripper) and c.object != NONE}
    kept = (
        condition
        for condition in state
        if all(compatible(condition, new) for new in operator.postconditions)
        and not (isinstance(condition, ObjectAt | ObjectRoughlyAt) and condition.object in held)
    )
    return frozenset(kept) | operator.postconditions


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
    """Grows one tree. Deterministic: equal goals and operators make equal trees."""

    def __init__(self, goals: Sequence[Condition], operators: Iterable[Operator], rollouts: int = 50) -> None:
        self.operators = sorted(operators, key=lambda operator: (operator.cost, repr(operator.action)))
        self.rollouts = rollouts
        self.goals = frozenset(goals)
        self.root = _Branch(is_sequence=True)
        for goal in goals:
            self.root.add(self._condition(goal))
        self.state = INITIAL
        self.failed: _Leaf | None = None

    def plan(self) -> Node:
        """The tree. Raises NothingLearnedError if the goal is not reached within the rollouts.

        A rollout starts where nothing has been done yet and ticks until the tree succeeds and the goal holds: an
        action within the tick may have undone what stands to its left.
        """
        for _ in range(self.rollouts):
            self.state = INITIAL
            expanded = False
            for _ in range(20 * (1 + self._size())):
                self.failed = None
                if self._tick(self.root) and self.goals <= self.state:
                    break
                if self.failed is not None and self._expand(self.failed):
                    expanded = True
            else:
                continue
            if not expanded:
                return self.root.node()
        raise NothingLearnedError("the planner does not reach the goal in its own world; its conditions conflict")

    def _size(self) -> int:
        return self.root.node().size

    def _tick(self, node: _Leaf | _Branch) -> bool:
        """Tick once; an action succeeds at once. The first condition that fails and can be expanded is remembered."""
        if isinstance(node, _Branch):
            if node.is_sequence:
                return all(self._tick(child) for child in list(node.children))
            return any(self._tick(child) for child in list(node.children))
        if isinstance(node.word, Operator):
            self.state = effects(node.word, self.state)
            return True
        holds = node.word in self.state and not node.fails_once
        node.fails_once = False
        if not holds and self.failed is None and node.parent is not None and node.parent.is_sequence:
            self.failed = node
        return holds

    def _condition(self, condition: Condition) -> _Leaf:
        """A leaf; the gripper's state fails once, since only the gripper can change in a world without physics."""
        return _Leaf(condition, fails_once=isinstance(condition, GripperIs))

    def _expand(self, failed: _Leaf) -> bool:
        operator = self._achiever(failed)
        if operator is None or failed.parent is None:
            return False
        parent, place = failed.parent, failed.parent.children.index(failed)
        chain = _Branch(is_sequence=True)
        for precondition in operator.preconditions:
            chain.add(self._condition(precondition))
        chain.add(_Leaf(operator))
        choice = _Branch(is_sequence=False, parent=parent)
        choice.add(failed)
        choice.add(chain)
        parent.children[place] = choice
        self._reorder(parent, choice, operator)
        return True

    def _achiever(self, failed: _Leaf) -> Operator | None:
        """The cheapest action that achieves the condition and is not already being prepared above."""
        above = set()
        node = failed.parent
        while node is not None:
            above |= {id(child.word) for child in node.children if isinstance(child, _Leaf)}
            node = node.parent
        fitting = (o for o in self.operators if failed.word in o.postconditions and id(o) not in above)
        return next(fitting, None)

    def _reorder(self, parent: _Branch, choice: _Branch, operator: Operator) -> None:
        """Move an expanded condition before the first sibling to its left that the new action would undo."""
        place = parent.children.index(choice)
        for index in range(place):
            if self._undoes(operator, parent.children[index]):
                parent.children.insert(index, parent.children.pop(place))
                return

    def _undoes(self, operator: Operator, sibling: _Leaf | _Branch) -> bool:
        condition = sibling if isinstance(sibling, _Leaf) else sibling.children[0]
        if not isinstance(condition, _Leaf) or isinstance(condition.word, Operator):
            return False
        wanted = condition.word
        return wanted not in effects(operator, frozenset({wanted}))
