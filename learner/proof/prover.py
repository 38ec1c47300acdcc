"""The proof of a tree: in the abstract world of its own conditions, from every state, ticking reaches the goal.

From each state one tick chooses an action and that leads to the next state; so trees are proven by following arrows.
A tree is refuted by a state in which it fails, goes round in a circle, begins an action for which the hand is not as
it must be, goes on though the task is done, or ends before; and by an action that fails wherever it is begun. All
states are ticked at once as arrays; nodes with memory count as reactive, since in this world no action is interrupted.
Only a Sequence with memory that lets go in several of its children goes on after the action that was done last, as long
as nothing before it has something to do: what it has reached it may leave.
Where something held is let go in the air, every place at which it may come to rest is followed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from learner.model import Node, SetGripper, Tree
from learner.model.tree import Value, is_reference
from learner.model.vocabulary import CONDITIONS, FALLBACKS, LEAVES, QUERIES, SEQUENCES, outputs_of
from learner.proof.abstract_world import (
    FIRST_LOCATION,
    NOBODY,
    NOTHING,
    AbstractWorld,
    Bools,
    Ints,
    Layout,
    Location,
    States,
)
from learner.proof.parameters import ProofParameters
from learner.relations.things import NO_THINGS, Things

FAILURE, RUNNING, SUCCESS = np.int8(0), np.int8(1), np.int8(2)
RELEASES: Final = ("Place", "Drop")
NOT_TO_THE_GOAL = "never to the goal"


@dataclass(frozen=True)
class Certificate:
    """What was proven. `states` were begun from, all there are if `exhaustive`; `bound` is the most actions from any
    of them to the goal, None if it is not reached; `counterexample` describes a state that refutes the tree and what
    is wrong there; None if there is none. `left_out` names states that were not begun from, None if there are none.
    """

    states: int
    exhaustive: bool
    bound: int | None
    counterexample: str | None
    left_out: str | None = None

    def to_data(self) -> dict[str, Any]:
        """For the manifest."""
        return dict(vars(self))


@dataclass(frozen=True)
class Instruction:
    """A node made ready to be ticked: equal leaves share a `leaf`, while `place` is a leaf's own.

    `ends` are the places of leaves whose success is that of the node. A Sequence that remembers begins at the child of
    number `begins[place]` after an action at one of its `places`; other nodes begin anew.
    """

    kind: str
    children: tuple[Instruction, ...] = ()
    leaf: int = NOTHING
    places: range = range(0)
    ends: frozenset[int] = frozenset()
    begins: Mapping[int, int] = field(default_factory=dict)

    @property
    def place(self) -> int:
        """Where a leaf stands in its tree; of other nodes that of their first leaf."""
        return self.places.start


class Program:
    """A flattened tree, made ready to be ticked in many states at once."""

    def __init__(self, root: Node) -> None:
        self.leaves: list[Node] = []
        """The distinct leaves."""
        self.places: list[Node] = []
        """All leaves, from left to right."""
        self.reads: list[tuple[tuple[str, Value], ...]] = []
        """Of each leaf the ports that refer to entries."""
        self._numbers: dict[Node, int] = {}
        self.remembered: set[int] = set()
        """The places after which a Sequence with memory goes on."""
        self.root = self._instruction(root)

    def _instruction(self, node: Node) -> Instruction:
        first = len(self.places)
        if not node.children:
            self.places.append(node)
            return Instruction(node.kind, (), self.number(node), range(first, first + 1), frozenset([first]))
        children = tuple(self._instruction(child) for child in node.children)
        begins = _begins(children) if _remembers(node) else {}
        self.remembered |= begins.keys()
        places = range(first, len(self.places))
        return Instruction(node.kind, children, NOTHING, places, _ends(node.kind, children), begins)

    def number(self, leaf: Node) -> int:
        """That of a leaf; one with its entries filled in gets one when it is first met."""
        if leaf not in self._numbers:
            self._numbers[leaf] = len(self.leaves)
            self.leaves.append(leaf)
            outputs = outputs_of(leaf.kind)
            self.reads.append(tuple(port for port in leaf.ports if port[0] not in outputs and is_reference(port[1])))
        return self._numbers[leaf]


def _remembers(node: Node) -> bool:
    """Whether a node is a Sequence with memory that lets go in several of its children."""
    releasing = [any(leaf.kind in RELEASES for leaf in child.walk()) for child in node.children]
    return node.kind == "Sequence" and sum(releasing) > 1


def _begins(children: Sequence[Instruction]) -> dict[int, int]:
    """At which child it is gone on after an action at a place in one of them; not where that is the first, or none."""
    after = {place: n + (place in child.ends) for n, child in enumerate(children) for place in child.places}
    return {place: number for place, number in after.items() if 0 < number < len(children)}


def _ends(kind: str, children: Sequence[Instruction]) -> frozenset[int]:
    """The places in a node of this kind whose success is that of the node."""
    if kind in FALLBACKS:
        return frozenset().union(*(child.ends for child in children))
    return children[-1].ends if kind in SEQUENCES else frozenset()


class Ticks:
    """One tick of a tree in many states: each one's `status`, and the `action` (a leaf's number) begun at what `place`.

    `unready` is an action that was begun although the hand was not as it must be, NOTHING if there is none. `worked`
    tells of each leaf in the tree whether it is an action that succeeded in any state, `failed` a state in which it
    was begun and failed. The `layout` of the states is worked out unless it is given.
    """

    def __init__(
        self, world: AbstractWorld, states: States, program: Program, layout: Layout | None = None
    ) -> None:  # fmt: skip
        self.world, self.states, self.program = world, states, program
        self.layout = layout or world.layout(states)
        self.action = np.full(len(states), NOTHING, dtype=np.intp)
        self.unready = np.full(len(states), NOTHING, dtype=np.intp)
        self.place = np.full(len(states), NOTHING, dtype=np.intp)
        self.worked = np.zeros(len(program.places), dtype=bool)
        self.failed: dict[int, int] = {}
        self._answers: dict[int, Bools] = {}
        self._found: dict[int, Ints] = {}
        self._entries: dict[Value, Ints] = {}
        """By reference, which object an entry is about (n,), NOBODY while it is not written ..."""
        self._writers: dict[Value, tuple[Node, str]] = {}
        """... and which query has written it, by which port."""
        succeeded, failed = self._tick(program.root, np.arange(len(states)))
        self.status = np.full(len(states), RUNNING)
        self.status[succeeded], self.status[failed] = SUCCESS, FAILURE

    def successors(self) -> tuple[States, Ints]:
        """The states that follow, and from which state each does: several where something is let go in the air."""
        locations, closed = self.states.locations.copy(), self.states.closed.copy()
        thrown, of = [], []
        for number in np.unique(self.action[self.action != NOTHING]):
            leaf, here = self.program.leaves[number], np.flatnonzero(self.action == number)
            states = self.states.take(here)
            after = self.world.after(leaf, states, self.layout.take(here))
            locations[:, here], closed[here] = after.locations, after.closed
            if leaf.word == SetGripper("open"):
                elsewhere, column = self.world.thrown(states)
                thrown.append(elsewhere)
                of.append(here[column])
        begun = np.flatnonzero(self.action != NOTHING)
        after, source = States.joined([States(locations, closed).take(begun), *thrown]), np.concatenate([begun, *of])
        return replace(after, resume=self._resumed_after(source)), source

    def _resumed_after(self, source: Ints) -> Ints | None:
        """The places after which a tree goes on in the states that some states lead to."""
        remembered = np.array(sorted(self.program.remembered), dtype=np.intp)
        places = self.place[source]
        return np.where(np.isin(places, remembered), places, NOTHING) if len(remembered) else None

    def _tick(self, instruction: Instruction, where: Ints) -> tuple[Ints, Ints]:
        """In which of some states a node succeeds, and in which it fails; in the others it runs."""
        if not len(where):
            return where, where
        if instruction.kind in LEAVES:
            return self._leaf(instruction, where)
        if instruction.kind in SEQUENCES:
            return self._in_turn(instruction, where)
        if instruction.kind in FALLBACKS:
            failed, succeeded = self._in_turn(instruction, where, otherwise=True)
            return succeeded, failed
        return self._decorated(instruction, *self._tick(instruction.children[0], where))

    def _in_turn(self, instruction: Instruction, where: Ints, otherwise: bool = False) -> tuple[Ints, Ints]:
        """Where all children succeed, and where one fails; `otherwise`, where all fail, and where one succeeds."""
        where, later = self._begun(instruction, where)
        ended = []
        for number, child in enumerate(instruction.children):
            where = np.concatenate([where, later[number]]) if number in later else where
            succeeded, failed = self._tick(child, where)
            where, end = (failed, succeeded) if otherwise else (succeeded, failed)
            ended.append(end)
        return where, np.concatenate(ended)

    def _begun(self, instruction: Instruction, where: Ints) -> tuple[Ints, dict[int, Ints]]:
        """In which states a node begins at its first child, and, by number, in which it goes on at another."""
        if not instruction.begins or self.states.resume is None:
            return where, {}
        children = np.zeros(len(self.program.places) - NOTHING, dtype=np.intp)
        children[list(instruction.begins)] = list(instruction.begins.values())
        numbers = children[self.states.resume[where]]
        return where[numbers == 0], {number: where[numbers == number] for number in set(instruction.begins.values())}

    def _decorated(self, instruction: Instruction, succeeded: Ints, failed: Ints) -> tuple[Ints, Ints]:
        if instruction.kind == "Inverter":
            return failed, succeeded
        both = np.concatenate([succeeded, failed])
        return (both, both[:0]) if instruction.kind == "ForceSuccess" else (both[:0], both)

    def _leaf(self, instruction: Instruction, where: Ints) -> tuple[Ints, Ints]:
        """As `_tick`; where a leaf reads entries, it is another one for each value of them."""
        if not self.program.reads[instruction.leaf]:
            return self._told(instruction.leaf, instruction.place, where)
        filled = list(self._filled(instruction.leaf, where))
        ends = [self._told(number, instruction.place, here) for number, here in filled]
        unwritten = np.setdiff1d(where, np.concatenate([where[:0], *(here for _, here in filled)]))
        succeeded, failed = ([end[k] for end in ends] for k in (0, 1))
        return np.concatenate([where[:0], *succeeded]), np.concatenate([unwritten, *failed])

    def _filled(self, number: int, where: Ints) -> Iterator[tuple[int, Ints]]:
        """The numbers of a leaf with the entries that it reads filled in, and in which of the states each is meant."""
        leaf, reads = self.program.leaves[number], self.program.reads[number]
        if not all(reference in self._entries for _, reference in reads):
            return
        numbers = [self._entries[reference][where] for _, reference in reads]
        keys = np.zeros(len(where), dtype=np.intp)
        for row in numbers:
            keys = keys * (len(self.world.objects) + 1) + row + 1
        for key in np.unique(keys):
            here = np.flatnonzero(keys == key)
            meant = [int(row[here[0]]) for row in numbers]
            if NOBODY not in meant:
                values = {port: self._value(ref, number) for (port, ref), number in zip(reads, meant, strict=True)}
                ports = tuple((port, values.get(port, value)) for port, value in leaf.ports)
                yield self.program.number(Node(leaf.kind, ports)), where[here]

    def _value(self, reference: Value, number: int) -> Value:
        query, port = self._writers[reference]
        return self.world.written(query, port, number)

    def _told(self, number: int, place: int, where: Ints) -> tuple[Ints, Ints]:
        leaf = self.program.leaves[number]
        if leaf.kind in QUERIES:
            return self._find(number, where)
        if leaf.kind in CONDITIONS:
            holds = self._answer(number)[where]
            return where[holds], where[~holds]
        return where[:0], self._begin(number, place, where)

    def _find(self, number: int, where: Ints) -> tuple[Ints, Ints]:
        """Where a query finds something, which is written, and where it fails."""
        query = self.program.leaves[number]
        if number not in self._found:
            self._found[number] = self.world.find(query, self.states, self.layout)
        found = self._found[number][where]
        here = found != NOBODY
        for port in outputs_of(query.kind):
            reference = query.port(port)
            entry = self._entries.setdefault(reference, np.full(len(self.states), NOBODY))
            entry[where[here]] = found[here]
            self._writers[reference] = query, port
        return where[here], where[~here]

    def _begin(self, number: int, place: int, where: Ints) -> Ints:
        """Begin an action where it can succeed; where it fails."""
        can = self._answer(number)[where]
        begun, failed = where[can], where[~can]
        self.action[begun], self.place[begun] = number, place
        self.worked[place] |= len(begun) > 0
        if len(failed):
            self.failed[place] = int(failed[0])
            ready = self.world.ready(self.program.leaves[number], self.states)[failed]
            self.unready[failed[~ready]] = number
        return failed

    def _answer(self, number: int) -> Bools:
        """What a leaf says in all states; asked once, since equal leaves stand in many places of a tree."""
        if number not in self._answers:
            leaf = self.program.leaves[number]
            ask = self.world.holds if leaf.kind in CONDITIONS else self.world.can
            self._answers[number] = ask(leaf, self.states, self.layout)
        return self._answers[number]


def prove(
    tree: Tree,
    base_frame: str,
    rng: np.random.Generator,
    task: Node | None = None,
    parameters: ProofParameters | None = None,
    at_once: bool = True,
    *,
    levels: int,
    things: Things = NO_THINGS,
) -> Certificate:
    """Check a tree from every abstract state, or, where there are too many (`parameters`), from some of them.

    States that are only reached from others are checked with them. The tree is taken at its word that its SUCCESS is
    the goal, unless `task` is given: a node that, ticked, says SUCCESS where the task is done. Then the tree may say so
    only there; and, if `at_once`, must. At most `levels` things lie upon one: as many as the tree is made to take down.
    `things` are all that may be in the way.
    """
    root = tree.flattened()
    roots = [root, task] if task else [root]
    world = AbstractWorld(base_frame, *roots, levels=levels, parameters=parameters, things=things)
    return Arena(world, rng).prove(root, task, at_once)


class Arena:
    """The states of a world from which trees are proven; to prove several trees in one world, make one."""

    def __init__(
        self,
        world: AbstractWorld,
        rng: np.random.Generator,
    ) -> None:
        self.world = world
        self.starts, self.whole = world.states(rng)

    def among(self, starts: States) -> Arena:
        """The same world with only some of its states to begin from."""
        fewer = copy(self)
        fewer.starts, fewer.whole = starts, self.whole and len(starts) == len(self.starts)
        return fewer

    def prove(self, root: Node, task: Node | None = None, at_once: bool = True) -> Certificate:
        """The certificate of a flattened tree; see the function of this name."""
        exploration = _Exploration(self.world, Program(root), Program(task) if task else None, at_once)
        bound, example = None, exploration.follow(self.starts)
        if example is None:
            bound, example = exploration.bound()
        return Certificate(len(self.starts), self.whole, None if example else bound, example, self.world.left_out)


class _Exploration:
    """The states reached so far, and where one tick leads from each."""

    def __init__(self, world: AbstractWorld, program: Program, task: Program | None, at_once: bool) -> None:
        self.world, self.program, self.task, self.at_once = world, program, task, at_once
        self.known = Keys(world, len(program.places) if program.remembered else 0)
        self.parts: list[States] = []
        self.keys: list[NDArray[Any]] = []
        self.following: list[NDArray[Any]] = []
        self.sources: list[Ints] = []
        self.acts: list[Bools] = []
        self.count = 0
        self.worked = np.zeros(len(program.places), dtype=bool)
        self.failed: dict[int, States] = {}

    def follow(self, starts: States) -> str | None:
        """Follow all starts to where they end; the first state that refutes the tree, in words, if one does."""
        frontier = self.known.fresh(starts)
        while len(frontier):
            afters = []
            for states in frontier.chunks(self.world.parameters.chunk):
                ticks = Ticks(self.world, states, self.program)
                fault = self._fault(ticks)
                if fault:
                    return fault
                afters.append(self._noted(ticks))
            frontier = self.known.fresh(States.joined(afters))
        return self._useless()

    def _noted(self, ticks: Ticks) -> States:
        """Write down what the ticks led to; the states after them."""
        after, source = ticks.successors()
        self.parts.append(ticks.states)
        self.keys.append(self.known.of(ticks.states))
        self.following.append(self.known.of(after))
        self.sources.append(source + self.count)
        self.acts.append(ticks.action != NOTHING)
        self.count += len(ticks.states)
        self.worked |= ticks.worked
        for place, column in ticks.failed.items():
            self.failed.setdefault(place, ticks.states.take([column]))
        return after

    def _fault(self, ticks: Ticks) -> str | None:
        """What is wrong in the first state of these in which something is."""
        unready, failing = np.flatnonzero(ticks.unready != NOTHING), np.flatnonzero(ticks.status == FAILURE)
        if len(unready):
            leaf = self.program.leaves[ticks.unready[unready[0]]]
            return self._in_words(ticks.states, unready[0], f"it begins {_word(leaf)}, for which the hand is not ready")
        if len(failing):
            return self._in_words(ticks.states, failing[0], f"nothing can be done, {NOT_TO_THE_GOAL}")
        return self._misjudged(ticks)

    def _misjudged(self, ticks: Ticks) -> str | None:
        """Where the tree ends before the task is done, or, if that is asked for, goes on though it is."""
        if self.task is None:
            return None
        done = Ticks(self.world, ticks.states, self.task, ticks.layout).status == SUCCESS
        ends = ticks.status == SUCCESS
        early, late = np.flatnonzero(ends & ~done), np.flatnonzero(~ends & done & self.at_once)
        if len(early):
            return self._in_words(ticks.states, early[0], "it ends before the task is done")
        return self._in_words(ticks.states, late[0], "it goes on though the task is done") if len(late) else None

    def _useless(self) -> str | None:
        """An action that fails wherever it is begun."""
        for place, states in self.failed.items():
            if not self.worked[place]:
                leaf = self.program.places[place]
                return self._in_words(states, 0, f"it begins {_word(leaf)}, which fails here and wherever it is begun")
        return None

    def bound(self) -> tuple[int, str | None]:
        """The most actions to the goal; or the first state, in words, of a circle that leads to none."""
        keys = np.concatenate(self.keys)
        order = np.argsort(keys)
        following = order[np.searchsorted(keys[order], np.concatenate(self.following))]
        source, acts = np.concatenate(self.sources), np.concatenate(self.acts)
        settled, count = ~acts, 0
        while True:
            blocked = np.zeros(len(keys), dtype=bool)
            blocked[source[~settled[following]]] = True
            if (settled == ~blocked).all():
                break
            settled, count = ~blocked, count + 1
        return count, None if settled.all() else self._in_a_circle(source, following, settled)

    def _in_a_circle(self, source: Ints, following: Ints, settled: Bools) -> str:
        """A state of a circle, in words: where one comes from an unsettled one in very many steps."""
        onward = np.arange(len(settled))
        endless = ~settled[following]
        onward[source[endless]] = following[endless]
        for _ in range(len(settled).bit_length()):
            onward = onward[onward]
        states = States.joined(self.parts).take(onward[~settled][:1])
        ticks = Ticks(self.world, states, self.program)
        leaf = self.program.leaves[ticks.action[0]]
        return self._in_words(states, 0, f"it goes on with {_word(leaf)}, {NOT_TO_THE_GOAL}")

    def _in_words(self, states: States, column: int, fault: str) -> str:
        """A state and what is wrong there."""
        world = self.world
        where = [
            f"{name} {_location(world.locations[name], int(states.locations[number, column]))}"
            for number, name in enumerate(world.objects)
        ]
        return f"the gripper {'closed' if states.closed[column] else 'open'}, {', '.join(where)}: {fault}"


class Keys:
    """States as sortable keys, exact: one number each where that fits, else bytes; and which of them are known.

    `places` are so many as states may go on after.
    """

    def __init__(self, world: AbstractWorld, places: int = 0) -> None:
        self.remembers = places > 0
        self.sizes = [2, *world.sizes, *([1 + places] if self.remembers else [])]
        self.fits = math.prod(self.sizes) < 2**62
        self.known: NDArray[Any] | None = None

    def of(self, states: States) -> NDArray[Any]:
        """The keys (n,)."""
        rows = [states.closed, *states.locations, *([states.resumed - NOTHING] if self.remembers else [])]
        if self.fits:
            key = np.zeros(len(states), dtype=np.int64)
            for size, row in zip(self.sizes, rows, strict=True):
                key = key * size + row
            return key
        table = np.ascontiguousarray(np.vstack(rows).T.astype(">u2"))
        return table.view(f"S{2 * len(rows)}")[:, 0]

    def fresh(self, states: States) -> States:
        """Those of the states that were not known, each once; they are known then."""
        keys, first = np.unique(self.of(states), return_index=True)
        if self.known is None:
            self.known = keys
            return states.take(np.sort(first))
        place = np.searchsorted(self.known, keys)
        new = self.known[np.minimum(place, len(self.known) - 1)] != keys
        self.known = np.insert(self.known, place[new], keys[new])
        return states.take(np.sort(first[new]))


def _location(locations: Sequence[Location], number: int) -> str:
    if number < FIRST_LOCATION:
        return ("away", "held")[number]
    location = locations[number - FIRST_LOCATION]
    return f"at {location.frame} ({', '.join(f'{value:.2f}' for value in location.position)})"


def _word(node: Node) -> str:
    ports = dict(node.ports)
    return f"{node.kind} {ports.get('object', ports.get('state', ports.get('signal', '')))}"
