"""The proof of a tree: in the abstract world of its own conditions, from every state, ticking reaches the goal.

A state says of every object that the tree names whether it is held, at one of the places that conditions speak of, or
away; and whether the gripper is open. Places are relative: what lies at a place in the frame of another object moves
with it. An action that can succeed does, and takes one step; it cannot if the gripper is not as it must be, if the
object is covered, or if its place is occupied. All states are ticked at once as arrays; nodes with memory count as
reactive, since in this world no action is interrupted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from learner.model import Node, Pose, Tree
from learner.model.names import NONE
from learner.model.pose import Array
from learner.model.tree import CONDITIONS, FALLBACKS, SEQUENCES
from learner.recovery import LEVELS

FAILURE, RUNNING, SUCCESS = np.int8(0), np.int8(1), np.int8(2)
AWAY: Final = 0
HELD: Final = 1
FIRST_PLACE: Final = 2
SAME_M: Final = 0.015
"""Two positions in one frame this near are one place."""
RESTS_M: Final = 0.03
"""A placement leads to the place in its frame this near to where the object is let go."""
OVERLAP_M: Final = 0.03
"""Nearer than this two objects cannot lie beside each other; one that much higher or lower is upon the other."""
UPON_M: Final = (0.02, 0.08)
"""How much higher an object's origin lies than that of the one it covers."""
EXHAUSTIVE: Final = 1_000_000
SAMPLED: Final = 100_000
CHUNK: Final = 50_000

Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]


@dataclass(frozen=True)
class Certificate:
    """What was proven. `bound` is the most actions from any state to the goal; `counterexample` describes a state
    from which the goal is not reached, and how it fails; None if there is none.
    """

    states: int
    exhaustive: bool
    bound: int
    counterexample: str | None

    def to_data(self) -> dict[str, Any]:
        """For the manifest."""
        return dict(vars(self))


@dataclass(frozen=True)
class Place:
    """A place that a condition speaks of: `position` [m] in `frame`."""

    frame: str
    position: tuple[float, float, float]


@dataclass
class States:
    """Many states: `locations` (n, objects) with AWAY, HELD or a place, `closed` (n,)."""

    locations: Ints
    closed: Bools

    def __len__(self) -> int:
        return len(self.closed)

    def take(self, rows: Any) -> States:
        """Some of the states."""
        return States(self.locations[rows], self.closed[rows])


class AbstractWorld:
    """The world of one tree's conditions: its objects, their places, and what each leaf does to many states."""

    def __init__(self, root: Node, base_frame: str) -> None:
        self.root, self.base_frame = root, base_frame
        leaves = [node for node in root.walk() if not node.children]
        self.grasps = {str(n.port("object")): _pose(n) for n in leaves if n.kind == "Pick"}
        self.objects = sorted({str(n.port("object")) for n in leaves if "object" in dict(n.ports)} - {NONE})
        self.index = {name: number for number, name in enumerate(self.objects)}
        self.places = {name: self._places_of(name, leaves) for name in self.objects}

    def _places_of(self, name: str, leaves: Sequence[Node]) -> list[Place]:
        """The distinct places of an object; of a pile in one frame only the lowest, the others follow."""
        found: list[Place] = []
        own = [n for n in leaves if dict(n.ports).get("object") == name]
        targets = {(str(n.port("frame")), self._let_go(n)) for n in own if n.kind in ("Place", "Drop")}
        dropped = [self._let_go(n) for n in own if n.kind == "Drop" and n.port("frame") == self.base_frame]
        spoken = [n for n in own if n.kind.startswith("Object") and not self._is_spot(n, dropped)]
        spots = sorted({(str(n.port("frame")), _vector(n.port("position"))) for n in spoken})
        for frame, position in spots:
            placed = any(f == frame and np.linalg.norm(np.subtract(p, position)) < RESTS_M for f, p in targets)
            lowest = not any(f == frame and _below(p, position) for f, p in spots)
            known = any(p.frame == frame and _near(p.position, position) for p in found)
            if (placed or lowest) and not known:
                found.append(Place(frame, position))
        return found

    def _is_spot(self, node: Node, dropped: Sequence[tuple[float, float, float]]) -> bool:
        """Whether a condition asks for a free spot on the table: a rough one in the base that no drop leads to."""
        if node.kind != "ObjectRoughlyAt" or node.port("frame") != self.base_frame:
            return False
        position, reach_m = _vector(node.port("position")), float(node.port("radius"))  # type: ignore[arg-type]  # a radius is a number
        return all(np.linalg.norm(np.subtract(at, position)[:2]) > reach_m for at in dropped)

    def _let_go(self, node: Node) -> tuple[float, float, float]:
        """Where the object's origin is when the end-effector stands at the target of a Place or Drop."""
        grasp = self.grasps.get(str(node.port("object")), Pose((0.0, 0.0, 0.0)))
        return (_pose(node) @ grasp.inverse()).position

    # -- states ----------------------------------------------------------------------------------------------------

    @cached_property
    def sizes(self) -> list[int]:
        """How many locations each object has."""
        return [FIRST_PLACE + len(self.places[name]) for name in self.objects]

    @property
    def count(self) -> int:
        """The number of states, impossible ones included."""
        return 2 * int(np.prod([float(size) for size in self.sizes], dtype=np.float64))

    def decode(self, codes: Ints) -> States:
        """The states with these numbers (n,)."""
        closed, rest = codes % 2 == 1, codes // 2
        columns = []
        for size in self.sizes:
            columns.append(rest % size)
            rest = rest // size
        return States(np.stack(columns, axis=1) if columns else np.zeros((len(codes), 0), np.intp), closed)

    def possible(self, states: States) -> Bools:
        """Which states can be: at most one object held, by a closed gripper and with nothing lying in its frame; none
        rests on itself or within another; what lies higher than upon the object of its frame has something beneath it;
        no pile is higher than recovery takes down, since none would stand.
        """
        held = states.locations == HELD
        fits = (held.sum(axis=1) <= 1) & (~held.any(axis=1) | states.closed)
        for name in self.objects:
            if name not in self.grasps:
                fits &= states.locations[:, self.index[name]] != HELD
        fits[fits] = self._consistent(states.take(fits), held[fits])
        return np.asarray(fits)

    def _consistent(self, states: States, held: Bools) -> Bools:
        """The part of `possible` that looks at how objects lie to one another."""
        roots, coordinates, cyclic = self.chains(states)
        fits = ~cyclic & (self._heights(states) <= LEVELS)
        for a in self.movable:
            for b in self.movable:
                together = roots[:, a] == roots[:, b]
                apart = np.linalg.norm(coordinates[:, a] - coordinates[:, b], axis=1)
                fits &= ~(together & (apart < OVERLAP_M)) | (a == b)
                fits &= ~(held[:, a] & (roots[:, b] == a)) | (a == b)
            fits &= self._supported(a, states, roots, coordinates)
        return np.asarray(fits)

    @cached_property
    def movable(self) -> list[int]:
        """The numbers of the objects that can be grasped: only they cover, occupy and are lifted."""
        return [number for number, name in enumerate(self.objects) if name in self.grasps]

    def _supported(self, a: int, states: States, roots: Ints, coordinates: Array) -> Bools:
        """Whether an object high above the object of its frame has another right below."""
        fits = np.ones(len(states), dtype=bool)
        for number, place in enumerate(self.places[self.objects[a]], start=FIRST_PLACE):
            if place.frame in self.grasps and place.position[2] > UPON_M[1]:
                here = states.locations[:, a] == number
                below = np.zeros(len(states), dtype=bool)
                for b in self.movable:
                    below |= self._upon(a, b, roots, coordinates)
                fits &= ~here | below
        return np.asarray(fits)

    def chains(self, states: States) -> tuple[Ints, Array, Bools]:
        """For each object what its chain of frames ends at (n, objects), its position from there (n, objects, 3), and
        which states (n,) have a cycle. A chain ends at the base (-1), or at an object that is away, held or fixed.
        """
        frames, offsets = self._tables
        n, m = states.locations.shape
        roots = np.tile(np.arange(m), (n, 1))
        coordinates = np.zeros((n, m, 3))
        rows = np.arange(n)[:, None]
        for _ in range(m + 1):
            inside = roots >= 0
            inside &= roots < m
            at = np.where(inside, roots, 0)
            location = states.locations[rows, at]
            step = inside & (frames[at, location] != -2)
            if not step.any():
                return roots, coordinates, np.zeros(n, dtype=bool)
            coordinates = coordinates + np.where(step[..., None], offsets[at, location], 0.0)
            roots = np.where(step, frames[at, location], roots)
        return roots, coordinates, np.asarray(step.any(axis=1))

    def _heights(self, states: States) -> Ints:
        """How many objects lie upon one another in the highest pile (n,), not counting the lowest."""
        frames, offsets = self._tables
        n, m = states.locations.shape
        at, height, alive = np.tile(np.arange(m), (n, 1)), np.zeros((n, m), np.intp), np.ones((n, m), bool)
        for _ in range(m):
            location = states.locations[np.arange(n)[:, None], at]
            height += alive & (offsets[at, location, 2] > UPON_M[0])
            following = frames[at, location]
            alive &= (following >= 0) & (following < m)
            at = np.where(alive, following, at)
        return np.asarray(height.max(axis=1, initial=0))

    @cached_property
    def _tables(self) -> tuple[Ints, Array]:
        """For each object and location the frame (-1 base, -2 none, from `len(objects)` on fixed ones), the offset."""
        most = max(self.sizes, default=FIRST_PLACE)
        frames = np.full((len(self.objects), most), -2, dtype=np.intp)
        offsets = np.zeros((len(self.objects), most, 3))
        for a, name in enumerate(self.objects):
            for number, place in enumerate(self.places[name], start=FIRST_PLACE):
                frames[a, number] = self._frame_number(place.frame)
                offsets[a, number] = place.position
        return frames, offsets

    def _frame_number(self, frame: str) -> int:
        if frame == self.base_frame:
            return -1
        return self.index[frame] if frame in self.index else len(self.objects) + self._fixed.index(frame)

    @cached_property
    def _fixed(self) -> list[str]:
        """Frames that are no objects of the tree: nothing moves them here."""
        named = {place.frame for places in self.places.values() for place in places}
        asked = {str(n.port("frame")) for n in self.root.walk() if "frame" in dict(n.ports)}
        return sorted((named | asked) - set(self.objects) - {self.base_frame})

    def _upon(self, a: int, b: int, roots: Ints, coordinates: Array) -> Bools:
        """Whether object a lies upon object b."""
        if a == b:
            return np.zeros(len(roots), dtype=bool)
        offset = coordinates[:, a] - coordinates[:, b]
        beside = np.linalg.norm(offset[:, :2], axis=1)
        over = (offset[:, 2] > UPON_M[0]) & (offset[:, 2] < UPON_M[1])
        return np.asarray((roots[:, a] == roots[:, b]) & over & (beside < OVERLAP_M))

    # -- leaves ----------------------------------------------------------------------------------------------------

    def holds(self, node: Node, states: States, roots: Ints, coordinates: Array) -> Bools:
        """In which states (n,) a condition holds."""
        if node.kind == "GripperIs":
            return np.asarray(states.closed == (node.port("state") == "closed"))
        held = states.locations == HELD
        name = str(node.port("object"))
        if node.kind == "InGripper":
            return np.asarray(~held.any(axis=1) if name == NONE else held[:, self.index[name]])
        root, origin = self._frame_of(node, roots, coordinates)
        a = self.index[name]
        offset = coordinates[:, a] - origin - np.array(node.port("position"))
        distance = np.linalg.norm(offset if node.kind == "ObjectAt" else offset[:, :2], axis=1)
        return np.asarray(~held[:, a] & (roots[:, a] == root) & (distance <= float(node.port("radius"))))  # type: ignore[arg-type]  # a radius is a number

    def _frame_of(self, node: Node, roots: Ints, coordinates: Array) -> tuple[Any, Array]:
        number = self._frame_number(str(node.port("frame")))
        if 0 <= number < len(self.objects):
            return roots[:, number], coordinates[:, number]
        return number, np.zeros((len(roots), 3))

    def can(self, node: Node, states: States, roots: Ints, coordinates: Array) -> Bools:
        """In which states (n,) an action succeeds."""
        if node.kind == "SetGripper":
            return np.ones(len(states), dtype=bool)
        a = self.index[str(node.port("object"))]
        held = states.locations == HELD
        if node.kind == "Pick":
            fits = ~states.closed & ~held[:, a]
            for b in self.movable:
                fits &= ~self._upon(b, a, roots, coordinates)
            return np.asarray(fits)
        fits = held[:, a]
        root, origin = self._frame_of(node, roots, coordinates)
        if node.kind == "Place":
            spot = origin + np.array(self._let_go(node))
            for b in self.movable:
                if b != a and self.objects[b] != node.port("frame"):
                    near = np.linalg.norm(coordinates[:, b] - spot, axis=1) < OVERLAP_M
                    fits = fits & ~((roots[:, b] == root) & near & ~held[:, b])
        return np.asarray(fits & (root != a))

    def after(self, node: Node, states: States) -> States:
        """The states after an action that succeeded in all of them."""
        locations, closed = states.locations.copy(), states.closed.copy()
        if node.kind == "SetGripper":
            closed[:] = node.port("state") == "closed"
            if node.port("state") == "open":
                locations[locations == HELD] = AWAY
            return States(locations, closed)
        name = str(node.port("object"))
        a = self.index[name]
        if node.kind == "Pick":
            locations[:, a], closed[:] = HELD, True
            self._leave_behind(name, locations)
        else:
            locations[:, a], closed[:] = self._reached(node), False
        return States(locations, closed)

    def _leave_behind(self, moved: str, locations: Ints) -> None:
        """What had its place in the frame of an object that is lifted out has it no longer."""
        for b, name in enumerate(self.objects):
            for number, place in enumerate(self.places[name], start=FIRST_PLACE):
                if place.frame == moved:
                    locations[locations[:, b] == number, b] = AWAY

    def _reached(self, node: Node) -> int:
        """The location that a Place or Drop leads to: the nearest place in its frame, else away."""
        let_go, frame = self._let_go(node), str(node.port("frame"))
        name = str(node.port("object"))
        distances = {
            number: float(np.linalg.norm(np.subtract(place.position, let_go)[: 3 if node.kind == "Place" else 2]))
            for number, place in enumerate(self.places[name], start=FIRST_PLACE)
            if place.frame == frame
        }
        nearest = min(distances, key=lambda number: distances[number], default=AWAY)
        near = nearest != AWAY and (node.kind == "Drop" or distances[nearest] < RESTS_M)
        return nearest if near else AWAY


class Ticks:
    """One tick of the tree in many states at once."""

    def __init__(self, world: AbstractWorld, states: States, root: Node | None = None) -> None:
        self.world, self.states = world, states
        self.roots, self.coordinates, _ = world.chains(states)
        self.chosen: list[Node] = []
        self._asked: dict[Node, Bools] = {}
        self.action = np.full(len(states), -1, dtype=np.intp)
        self.status = self._tick(root or world.root, np.arange(len(states)))

    def successors(self) -> States:
        """The states after the action that each tick chose; unchanged where it chose none."""
        locations, closed = self.states.locations.copy(), self.states.closed.copy()
        for number, node in enumerate(self.chosen):
            rows = self.action == number
            if rows.any():
                after = self.world.after(node, self.states.take(rows))
                locations[rows], closed[rows] = after.locations, after.closed
        return States(locations, closed)

    def _tick(self, node: Node, rows: Ints) -> NDArray[np.int8]:
        if not len(rows):
            return np.zeros(0, dtype=np.int8)
        if node.kind in CONDITIONS:
            return np.where(self._answer(node)[rows], SUCCESS, FAILURE)
        if node.kind in SEQUENCES or node.kind in FALLBACKS:
            return self._in_turn(node, rows, SUCCESS if node.kind in SEQUENCES else FAILURE)
        if node.children:
            return self._decorated(node, self._tick(node.children[0], rows))
        return self._begin(node, rows)

    def _in_turn(self, node: Node, rows: Ints, goes_on: np.int8) -> NDArray[np.int8]:
        status = np.full(len(rows), goes_on, dtype=np.int8)
        left = np.arange(len(rows))
        for child in node.children:
            status[left] = self._tick(child, rows[left])
            left = left[status[left] == goes_on]
        return status

    def _decorated(self, node: Node, status: NDArray[np.int8]) -> NDArray[np.int8]:
        if node.kind == "Inverter":
            return (SUCCESS - status).astype(np.int8)
        forced = SUCCESS if node.kind == "ForceSuccess" else FAILURE
        return np.where(status == RUNNING, RUNNING, forced)

    def _answer(self, leaf: Node) -> Bools:
        """What a leaf says in all states; asked once, since the same leaf stands in many places of a tree."""
        if leaf not in self._asked:
            ask = self.world.holds if leaf.kind in CONDITIONS else self.world.can
            self._asked[leaf] = ask(leaf, self.states, self.roots, self.coordinates)
        return self._asked[leaf]

    def _begin(self, node: Node, rows: Ints) -> NDArray[np.int8]:
        can = self._answer(node)[rows]
        self.action[rows[can]] = len(self.chosen)
        self.chosen.append(node)
        return np.where(can, RUNNING, FAILURE)


def prove(
    tree: Tree, base_frame: str, rng: np.random.Generator, task: Node | None = None, exhaustive: int = EXHAUSTIVE
) -> Certificate:
    """Check a tree from every abstract state, or, where there are more than `exhaustive`, from a sample.

    States that are only reached from others are checked with them. The tree is taken at its word that its SUCCESS is
    the goal, unless `task` is given: a tree whose world and whose SUCCESS are what counts.
    """
    root = tree.flattened()
    world = AbstractWorld(task or root, base_frame)
    whole = world.count <= exhaustive
    starts = every_state(world) if whole else _sample(world, rng)
    states, status, successor = _explored(world, starts, root)
    status = _by_the_task(world, states, status) if task else status
    at, bound = np.arange(len(starts)), 0
    while (moving := status[at] == RUNNING).any() and bound < _patience(world):
        at = np.where(moving, successor[at], at)
        bound += 1
    failing = np.flatnonzero(status[at] != SUCCESS)
    example = _describe(world, root, states.take(at[failing[:1]])) if len(failing) else None
    return Certificate(len(starts), whole, bound, example)


def _by_the_task(world: AbstractWorld, states: States, status: NDArray[np.int8]) -> NDArray[np.int8]:
    """A SUCCESS where the task is not done is a failure."""
    done = np.concatenate([Ticks(world, states.take(slice(b, b + CHUNK))).status for b in range(0, len(states), CHUNK)])
    return np.where((status == SUCCESS) & (done != SUCCESS), FAILURE, status)


def every_state(world: AbstractWorld) -> States:
    """All states that can be."""
    parts = []
    for begin in range(0, world.count, CHUNK):
        states = world.decode(np.arange(begin, min(begin + CHUNK, world.count)))
        parts.append(states.take(world.possible(states)))
    return _joined(parts)


def _sample(world: AbstractWorld, rng: np.random.Generator) -> States:
    """States drawn at random; in those that cannot be, one object after the other is taken away."""
    sizes = np.array(world.sizes)
    states = States(rng.integers(0, sizes, (SAMPLED, len(sizes))), rng.random(SAMPLED) < 0.5)
    wrong = np.flatnonzero(~world.possible(states))
    while len(wrong):
        states.locations[wrong, rng.integers(0, len(sizes), len(wrong))] = AWAY
        states.closed[wrong] = (states.locations[wrong] == HELD).any(axis=1)
        wrong = wrong[~world.possible(states.take(wrong))]
    return states


def _explored(world: AbstractWorld, starts: States, root: Node) -> tuple[States, NDArray[np.int8], Ints]:
    """All states that are reached from the starts (first, in their order), each one's status and its successor."""
    parts, status, successor = [starts], [], []
    numbers: dict[bytes, int] = {}
    for number, key in enumerate(_keys(starts)):
        numbers.setdefault(key, number)
    total, frontier = len(starts), starts
    while len(frontier):
        fresh = []
        for begin in range(0, len(frontier), CHUNK):
            ticks = Ticks(world, frontier.take(slice(begin, begin + CHUNK)), root)
            after = ticks.successors()
            status.append(ticks.status)
            follow = np.empty(len(after), dtype=np.intp)
            new = []
            for row, key in enumerate(_keys(after)):
                follow[row] = numbers.setdefault(key, total)
                if follow[row] == total:
                    new.append(row)
                    total += 1
            successor.append(follow)
            fresh.append(after.take(np.array(new, dtype=np.intp)))
        frontier = _joined(fresh)
        parts.append(frontier)
    return _joined(parts), np.concatenate(status), np.concatenate(successor)


def _keys(states: States) -> list[bytes]:
    rows = np.column_stack([states.locations, states.closed]).astype(np.uint16)
    return [row.tobytes() for row in rows]


def _joined(parts: Sequence[States]) -> States:
    return States(np.concatenate([p.locations for p in parts]), np.concatenate([p.closed for p in parts]))


def _patience(world: AbstractWorld) -> int:
    """More steps than any sensible way to the goal takes: beyond it the tree goes round in a circle."""
    return 20 + 12 * sum(world.sizes)


def _describe(world: AbstractWorld, root: Node, states: States) -> str:
    """The first state in words, and what the tree does there."""
    where = [
        f"{name} {_location(world.places[name], int(states.locations[0, number]))}"
        for number, name in enumerate(world.objects)
    ]
    ticks = Ticks(world, states, root)
    goes_on = ticks.action[0] >= 0
    stuck = f"it goes on with {_word(ticks.chosen[ticks.action[0]])}" if goes_on else "nothing can be done"
    stuck = "it ends before the task is done" if ticks.status[0] == SUCCESS else f"{stuck}, never to the goal"
    return f"the gripper {'closed' if states.closed[0] else 'open'}, {', '.join(where)}: {stuck}"


def _location(places: Sequence[Place], location: int) -> str:
    if location < FIRST_PLACE:
        return ("away", "held")[location]
    place = places[location - FIRST_PLACE]
    return f"at {place.frame} ({', '.join(f'{value:.2f}' for value in place.position)})"


def _word(node: Node) -> str:
    ports: Mapping[str, Any] = dict(node.ports)
    return f"{node.kind} {ports.get('object', ports.get('state'))}"


def _pose(node: Node) -> Pose:
    return Pose(_vector(node.port("position")), tuple(node.port("orientation")))  # type: ignore[arg-type]  # ports are checked by Tree


def _vector(value: Any) -> tuple[float, float, float]:
    x, y, z = value
    return (x, y, z)


def _near(a: Sequence[float], b: Sequence[float]) -> bool:
    return float(np.linalg.norm(np.subtract(a, b))) < SAME_M


def _below(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether a stands under b in a pile: nearer to the origin, in the same direction."""
    reach_a, reach_b = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    return SAME_M < reach_a < reach_b - SAME_M and float(np.dot(a, b)) > 0.9 * reach_a * reach_b
