"""What a tick means: BehaviorTree.CPP 4's semantics of the contract's nodes, as a small fast interpreter.

The planner proves trees with it, the experiments tick it millions of times, and the tests hold
`learner.execution.engine` and the real BehaviorTree.CPP against it: the same leaves in the same order, the same halts,
the same statuses.

The rules that follow from BehaviorTree.CPP (4.8, sources in src/controls and src/decorators):

- A Sequence or Fallback remembers which child was running and goes on there. It forgets when it ends or is halted.
- A reactive one begins at its first child on every tick. When it comes to rest on another child than the one that was
  running, the old child is halted *after* the new one was ticked: for a moment two actions are under way, and leaves
  have to bear that.
- A RUNNING child makes every node above it RUNNING. So between two ticks at most one leaf runs, and halting a node
  halts at most that one.
- A node that has ended begins anew at its next tick; nothing is remembered beyond the end.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Final, Protocol

from learner.errors import TreeError
from learner.execution.entries import Entries, Found
from learner.model.tree import Node
from learner.model.vocabulary import ACTIONS, CONDITIONS, DECORATORS, FALLBACKS, QUERIES, SEQUENCES


class Status(Enum):
    """What a tick returns. (BehaviorTree.CPP's IDLE is never returned by a tick; SKIPPED needs scripts.)"""

    RUNNING = "running"
    SUCCESS = "success"
    FAILURE = "failure"


class Leaves(Protocol):
    """What a tree acts on: a planner's world, a simulation, or a cell.

    Leaves are told apart by identity (`is`), not by value: a flattened tree may hold equal leaves at two places.
    """

    def check(self, node: Node) -> bool:
        """Whether the condition `node` holds."""
        ...

    def find(self, node: Node) -> Found | None:
        """What the query `node` finds, by its output ports; None if it fails."""
        ...

    def tick_action(self, node: Node) -> Status:
        """Start the action `node` if it is not under way, else go on with it."""
        ...

    def halt_action(self, node: Node) -> None:
        """Stop the action `node`, which was RUNNING; another may have been started before in the same tick."""
        ...


Tick = Callable[[], Status]
Halt = Callable[[], None]
Compiled = tuple[Tick, Halt]

_RUNNING: Final = Status.RUNNING
_SUCCESS: Final = Status.SUCCESS
_FAILURE: Final = Status.FAILURE
_NOBODY: Final = -1
_INVERTED: Final = {_RUNNING: _RUNNING, _SUCCESS: _FAILURE, _FAILURE: _SUCCESS}
_ALWAYS_SUCCESS: Final = {_RUNNING: _RUNNING, _SUCCESS: _SUCCESS, _FAILURE: _SUCCESS}
_ALWAYS_FAILURE: Final = {_RUNNING: _RUNNING, _SUCCESS: _FAILURE, _FAILURE: _FAILURE}
_MAPPED: Final = {"Inverter": _INVERTED, "ForceSuccess": _ALWAYS_SUCCESS, "ForceFailure": _ALWAYS_FAILURE}


class Ticker:
    """A flattened tree bound to its leaves, compiled to closures once.

    Raises TreeError for a SubTree (flatten first: `Tree.flattened()`) or a node of another vocabulary. An exception of
    a leaf passes through `tick`; afterwards the tree does not know that leaf as running.
    """

    def __init__(self, root: Node, world: Leaves) -> None:
        self.tick: Tick
        """Tick once; the status of the root."""
        self.halt: Halt
        """Halt the leaf that runs, if one does; the next tick begins anew."""
        self.tick, self.halt = _compile(root, world, Entries())


def _compile(node: Node, world: Leaves, entries: Entries) -> Compiled:
    if node.kind in QUERIES:
        return _query(node, world, entries), _nothing
    if node.kind in CONDITIONS:
        return _condition(node, world, entries), _nothing
    if node.kind in ACTIONS:
        return _action(node, world, entries)
    children = [_compile(child, world, entries) for child in node.children]
    if node.kind in DECORATORS:
        return _decorator(node.kind, *children)
    if node.kind not in (*SEQUENCES, *FALLBACKS):
        raise TreeError(f"{node.kind} {node.id or ''} cannot be ticked: flatten the tree first")
    passing = _SUCCESS if node.kind in SEQUENCES else _FAILURE
    combine = _reactive if node.kind.startswith("Reactive") else _remembering
    return combine([tick for tick, _ in children], [halt for _, halt in children], passing)


def _condition(node: Node, world: Leaves, entries: Entries) -> Tick:
    check, bound = world.check, entries.bound(node)

    def tick() -> Status:
        filled = bound()
        return _SUCCESS if filled is not None and check(filled) else _FAILURE

    return tick


def _query(node: Node, world: Leaves, entries: Entries) -> Tick:
    bound = entries.bound(node)

    def tick() -> Status:
        filled = bound()
        found = None if filled is None else world.find(filled)
        if found is None:
            return _FAILURE
        entries.write(node, found)
        return _SUCCESS

    return tick


def _nothing() -> None:
    """Halting what cannot run."""


def _action(node: Node, world: Leaves, entries: Entries) -> Compiled:
    tick_action, halt_action, bound = world.tick_action, world.halt_action, entries.bound(node)
    running: Node | None = None

    def tick() -> Status:
        nonlocal running
        filled, running = running or bound(), None
        if filled is None:
            return _FAILURE
        status = tick_action(filled)
        running = filled if status is _RUNNING else None
        return status

    def halt() -> None:
        nonlocal running
        if running is not None:
            halted, running = running, None
            halt_action(halted)

    return tick, halt


def _decorator(kind: str, child: Compiled) -> Compiled:
    tick_child, halt_child = child
    mapped = _MAPPED[kind]

    def tick() -> Status:
        return mapped[tick_child()]

    return tick, halt_child


def _reactive(ticks: list[Tick], halts: list[Halt], passing: Status) -> Compiled:
    """ReactiveSequence (`passing` is SUCCESS) and ReactiveFallback (FAILURE)."""
    running = _NOBODY

    def tick() -> Status:
        nonlocal running
        index, status = _NOBODY, passing
        for index, tick_child in enumerate(ticks):  # noqa: B007  # the child on which the tick came to rest
            status = tick_child()
            if status is not passing:
                break
        before, running = running, index if status is _RUNNING else _NOBODY
        if before > index:
            halts[before]()
        return status

    def halt() -> None:
        nonlocal running
        if running != _NOBODY:
            before, running = running, _NOBODY
            halts[before]()

    return tick, halt


def _remembering(ticks: list[Tick], halts: list[Halt], passing: Status) -> Compiled:
    """Sequence (`passing` is SUCCESS) and Fallback (FAILURE), with memory."""
    current, count = 0, len(ticks)

    def tick() -> Status:
        nonlocal current
        status = passing
        while current < count:
            status = ticks[current]()
            if status is _RUNNING:
                return status
            if status is not passing:
                break
            current += 1
        current = 0
        return status

    def halt() -> None:
        nonlocal current
        before, current = current, 0
        halts[before]()

    return tick, halt
