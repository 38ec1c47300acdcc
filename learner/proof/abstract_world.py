"""The abstract world of a tree: the locations that its conditions speak of, what lies where, and what each leaf does.

A state says of every object that the tree names whether it is held, at one of the locations that they speak of, or
away; and whether the gripper is open. Places are relative: what lies at a location in the frame of another object moves
with it. An action that can succeed does, and takes one step; it cannot if the gripper is not as it must be, if the
object is covered, or if its location is occupied. What is let go beside an object that itself lies upon another falls.
Many states are looked at together: arrays have a row an object and a column a state.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from learner.errors import TreeError
from learner.model import GripperIs, InGripper, Motion, Node, ObjectAt, ObjectRoughlyAt, Pose, SetGripper
from learner.model.condition import ObjectPosedAt
from learner.model.frame import is_composed, objects_of
from learner.model.names import NONE
from learner.model.pose import IDENTITY_XYZW, Vector
from learner.model.query import FindGrasp, FindHeld, FindInTheWay, FindSpot, FindUnder, FindUpon
from learner.model.tree import Value, Word, is_reference
from learner.model.vocabulary import QUERIES, outputs_of
from learner.proof.parameters import ProofParameters
from learner.relations.things import NO_THINGS, Things

NOBODY: Final = -1
NOTHING: Final = -1
AWAY: Final = 0
HELD: Final = 1
FIRST_LOCATION: Final = 2
X, Y, Z, LEVEL, RAISED = range(5)

Spoken = ObjectAt | ObjectRoughlyAt
"""The conditions that speak of where an object is."""
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]
LocationNumbers = NDArray[np.int16]
Floats = NDArray[np.float32]
FIXED: Final = "that frames which go by several objects move with them"

TURNED: Final = "how objects are turned"


def _piles(levels: int) -> str:
    return f"piles of more than {levels + 1} objects"


@dataclass(frozen=True)
class Location:
    """Where a condition may want an object: `position` [m] in `frame`, `exact` if its height matters to a condition."""

    frame: str
    position: Vector
    exact: bool


@dataclass(frozen=True)
class States:
    """Many states: `locations` (objects, n) with AWAY, HELD or a location, `closed` (n,).

    `resume` (n,) is the place in a tree of the action that was done last, where a Sequence with memory goes on after
    it, NOTHING where none does; None if there is no such place.
    """

    locations: LocationNumbers
    closed: Bools
    resume: Ints | None = None

    def __len__(self) -> int:
        return len(self.closed)

    def take(self, columns: Any) -> States:
        """Some of the states."""
        resume = None if self.resume is None else self.resume[columns]
        return States(self.locations[:, columns], self.closed[columns], resume)

    @property
    def resumed(self) -> Ints:
        """`resume`, of each state."""
        return np.full(len(self), NOTHING, dtype=np.intp) if self.resume is None else self.resume

    def chunks(self, size: int) -> Iterator[States]:
        """The states in order, so many at a time."""
        for begin in range(0, len(self), size):
            yield self.take(slice(begin, begin + size))

    @staticmethod
    def joined(parts: Sequence[States]) -> States:
        """All states of some, in order."""
        locations = np.concatenate([part.locations for part in parts], axis=1)
        closed = np.concatenate([part.closed for part in parts])
        if all(part.resume is None for part in parts):
            return States(locations, closed)
        return States(locations, closed, np.concatenate([part.resumed for part in parts]))


@dataclass(frozen=True)
class Layout:
    """How things lie to one another in many states; a row an object, then one for the base and each fixed frame.

    `roots` (rows, n): what a chain of frames ends at, which is an object that is away or held, the base or a fixed
    frame. `offsets` (5, rows, n): the position from there [m], and upon how many objects one lies in the chain, of any
    kind (LEVEL) and of those that can be grasped (RAISED).
    """

    roots: NDArray[np.int32]
    offsets: Floats

    def take(self, columns: Any) -> Layout:
        """The layout of some of the states."""
        return Layout(self.roots[:, columns], self.offsets[:, :, columns])

    def near(self, a: int, spot: Floats, root: NDArray[np.int32], radius_m: float, axes: int = 3) -> Bools:
        """Where a lies within a distance of a spot (3, n) from `root` (n,); with two axes, of its vertical."""
        squared = np.square(self.offsets[X, a] - spot[X])
        for axis in range(1, axes):
            squared += np.square(self.offsets[axis, a] - spot[axis])
        return np.asarray((squared <= radius_m * radius_m) & (self.roots[a] == root))


class AbstractWorld:
    """The world of some trees' conditions: its objects, their locations, and what each leaf does to many states.

    At most `levels` things lie upon one: so many as the trees are made to take down. Where a tree asks for relations,
    any of the `things` may lie upon any other, and on any place that the tree speaks of.
    """

    def __init__(
        self, base_frame: str, *roots: Node, levels: int, parameters: ProofParameters | None = None,
        things: Things = NO_THINGS,
    ) -> None:  # fmt: skip
        self.base_frame, self.levels, self.parameters = base_frame, levels, parameters or ProofParameters()
        leaves = list(dict.fromkeys(node for root in roots for node in root.walk() if not node.children))
        words = [node.word for node in leaves if not any(is_reference(value) for value in _read(node).values())]
        self.things = things if any(node.kind in QUERIES for node in leaves) else NO_THINGS
        picks = {w.object: w.pose for w in words if isinstance(w, Motion) and w.type == "Pick"}
        self.grasps = {**self.things.grasps, **picks}
        named = {w.object for w in words if isinstance(w, Motion | Spoken | InGripper)}
        self.objects = sorted((named | self.things.grasps.keys()) - {NONE})
        asked = {w.frame for w in words if isinstance(w, Motion | Spoken)}
        self.frames = [*self.objects, base_frame, *sorted(asked - {*self.objects, base_frame})]
        self.index = {name: number for number, name in enumerate(self.frames)}
        self.movable = [self.index[name] for name in self.objects if name in self.grasps]
        self.locations = {name: self._locations_of(name, words) for name in self.objects}
        self.sizes = [FIRST_LOCATION + len(self.locations[name]) for name in self.objects]
        self._unseen = [FIXED] if any(is_composed(frame) for frame in self.frames) else []
        self._unseen += [TURNED] if any(isinstance(word, ObjectPosedAt) for word in words) else []
        self.left_out = "; ".join(self._unseen) or None
        """What the proof does not see: piles that recovery does not take down, frames that move with two objects."""

    def _locations_of(self, name: str, words: Sequence[Word]) -> list[Location]:
        """The distinct locations of an object; of a pile in one frame only the lowest, the others follow."""
        found: list[Location] = []
        motions = [w for w in words if isinstance(w, Motion) and w.object == name and w.type != "Pick"]
        targets = {(m.frame, self._let_go(m)) for m in motions}
        dropped = [self._let_go(m) for m in motions if m.type == "Drop" and m.frame == self.base_frame]
        own = [w for w in words if isinstance(w, Spoken) and w.object == name]
        spoken = [condition for condition in own if not self._is_spot(condition, dropped)]
        exact = {(c.frame, c.position) for c in spoken if isinstance(c, ObjectAt)}
        spots = sorted({(c.frame, c.position) for c in spoken})
        for frame, position in spots:
            axes = 3 if (frame, position) in exact else 2
            placed = any(
                f == frame and math.dist(p[:axes], position[:axes]) < self.parameters.rests_m for f, p in targets
            )
            lowest = not any(f == frame and self._is_below(frame, p, position) for f, p in spots)
            known = any(p.frame == frame and math.dist(p.position, position) < self.parameters.same_m for p in found)
            if (placed or lowest) and not known:
                found.append(Location(frame, position, (frame, position) in exact))
        return [*found, *self._astray(name, words, found)]

    def _astray(self, name: str, words: Sequence[Word], own: Sequence[Location]) -> list[Location]:
        """Where an object may lie that the tree does not want there: upon another, or on the place of another."""
        places = [(under, at) for (upper, under), at in self.things.upon.items() if upper == name]
        exact = [w for w in words if isinstance(w, ObjectAt) and w.object != name and name not in objects_of(w.frame)]
        places += [(w.frame, w.position) for w in exact] if self.things.grasps else []
        found: list[Location] = []
        for frame, position in dict.fromkeys(places):
            same = (p for p in (*own, *found) if p.frame == frame)
            if not any(math.dist(p.position, position) < self.parameters.same_m for p in same):
                found.append(Location(frame, position, exact=True))
        return found

    def _is_below(self, frame: str, a: Vector, b: Vector) -> bool:
        """Whether a stands under b in a pile: on one vertical of the base; in an object's frame, which may lie on any
        side, nearer to the origin in the same direction.
        """
        if frame == self.base_frame:
            return math.dist(a[:2], b[:2]) < self.parameters.overlap_m and a[2] < b[2] - self.parameters.same_m
        reach_a, reach_b = math.hypot(*a), math.hypot(*b)
        return (
            self.parameters.same_m < reach_a < reach_b - self.parameters.same_m
            and float(np.dot(a, b)) > self.parameters.same_direction * reach_a * reach_b
        )

    def _is_spot(self, condition: Spoken, dropped: Sequence[Vector]) -> bool:
        """Whether a condition asks for a free spot on the table: a rough one in the base that no drop leads to."""
        if isinstance(condition, ObjectAt) or condition.frame != self.base_frame:
            return False
        away = (np.linalg.norm(np.subtract(at, condition.position)[:2]) for at in dropped)
        return all(distance > condition.radius for distance in away)

    def _let_go(self, motion: Motion) -> Vector:
        """Where the object's origin is when the end-effector stands at the target of a Place or Drop."""
        grasp = self.grasps.get(motion.object, Pose((0.0, 0.0, 0.0)))
        return (motion.pose @ grasp.inverse()).position

    @cached_property
    def _steps(self) -> tuple[NDArray[np.int32], Floats]:
        """For each object and location its frame (itself where the chain ends), and the offset (5, …) from there."""
        most = max(self.sizes, default=FIRST_LOCATION)
        frames = np.repeat(np.arange(len(self.objects), dtype=np.int32)[:, None], most, axis=1)
        offsets = np.zeros((5, len(self.objects), most), dtype=np.float32)
        for a, name in enumerate(self.objects):
            for number, location in enumerate(self.locations[name], start=FIRST_LOCATION):
                upon = location.position[2] > self.parameters.upon_m[0]
                frames[a, number] = self.index[location.frame]
                on_object, on_movable = (
                    upon and location.frame != self.base_frame,
                    upon and location.frame in self.grasps,
                )
                offsets[:, a, number] = (*location.position, on_object, on_movable)
        return frames, offsets

    @cached_property
    def _chained(self) -> Bools:
        """For each object and location whether it is in the frame of an object that may itself be in another's."""
        frames, _ = self._steps
        elsewhere = frames != np.arange(len(self.objects))[:, None]
        placed = np.append(elsewhere.any(axis=1), np.zeros(len(self.frames) - len(self.objects), dtype=np.bool_))
        return np.asarray(elsewhere & placed[frames])

    # -- states ----------------------------------------------------------------------------------------------------

    def layout(self, states: States) -> Layout:
        """How things lie in states without a circle of frames: chains are followed twice as far in each turn."""
        roots, offsets, chained = self._first_steps(states)
        count, flat_roots, flat_offsets = np.intp(len(states)), roots.reshape(-1), offsets.reshape(5, -1)
        pending = np.flatnonzero(chained)
        while len(pending):
            ends = flat_roots[pending] * count + pending % count
            onward = flat_roots[ends]
            goes_on = onward != flat_roots[pending]
            pending, ends = pending[goes_on], ends[goes_on]
            for row in flat_offsets:
                row[pending] += row[ends]
            flat_roots[pending] = onward[goes_on]
        return Layout(roots, offsets)

    def _first_steps(self, states: States) -> tuple[NDArray[np.int32], Floats, Bools]:
        """The frame that each object lies in, the offset from there, and whether that frame may lie in another's."""
        (frames, steps), rows = self._steps, len(self.frames)
        roots = np.repeat(np.arange(rows, dtype=np.int32)[:, None], len(states), axis=1)
        offsets = np.zeros((5, rows, len(states)), dtype=np.float32)
        chained = np.zeros((len(self.objects), len(states)), dtype=np.bool_)
        for a, locations in enumerate(states.locations.astype(np.intp)):
            np.take(frames[a], locations, out=roots[a], mode="clip")  # without a copy of what it writes to
            np.take(self._chained[a], locations, out=chained[a], mode="clip")
            for offset, step in zip(offsets, steps, strict=True):
                np.take(step[a], locations, out=offset[a], mode="clip")
        return roots, offsets, chained

    def states(self, rng: np.random.Generator) -> tuple[States, bool]:
        """All states that can be, sorted, and True; or, if there are too many (`parameters`), some of them at random.

        Possible is: at most one object held, by a closed gripper and with nothing lying in its frame; none rests on
        itself or within another; what is high above the object of its frame, or beside one that lies upon another,
        has something beneath it; no pile is higher than recovery takes down (see `left_out`).
        """
        exhaustive, sampled = self.parameters.exhaustive, self.parameters.sampled
        partial, whole = States(np.zeros((len(self.objects), 1), np.int16), np.ones(1, bool)), True
        for a in range(len(self.objects)):
            share = self._share(partial, a, exhaustive if whole else 2 * sampled, 4 * sampled, rng)
            partial, whole = self._laid(partial, a, rng, share), whole and share == 1
            if len(partial) > exhaustive or not whole:
                partial, whole = _drawn(partial, 2 * sampled, rng), False
        partial = States.joined([part.take(self._carried(part)) for part in partial.chunks(self.parameters.chunk)])
        free = (partial.locations != HELD).all(axis=0)
        found = States.joined([partial, States(partial.locations[:, free], np.zeros(int(free.sum()), bool))])
        if len(found) > exhaustive or not whole:
            return _drawn(found, sampled, rng), False
        return found, True

    def _share(self, partial: States, a: int, few: int, enough: int, rng: np.random.Generator) -> float:
        """With what share of the next states there are about `enough`; all of them (1) unless surely more than `few`.

        A probe tells how many there are: to make all, only to draw some of them, takes the time of the whole proof.
        """
        if len(partial) * self.sizes[a] <= 2 * few:
            return 1.0
        probe = _drawn(partial, self.parameters.probe, rng)
        expected = len(partial) * len(self._laid(probe, a, rng)) / len(probe)
        return 1.0 if expected <= 2 * few else min(1.0, enough / expected)

    def _laid(self, partial: States, a: int, rng: np.random.Generator, share: float = 1.0) -> States:
        """The states in which also object a is held or laid somewhere, where it can be; or a share of them."""
        size = self.sizes[a]
        parts = []
        for begin in range(0, len(partial), max(self.parameters.chunk // size, 1)):
            part = partial.take(slice(begin, begin + max(self.parameters.chunk // size, 1)))
            fits = self._free_for(a, part)
            if share < 1:
                fits &= rng.random(fits.shape) < share
            columns, locations = np.nonzero(fits.T)
            laid = part.take(columns)
            laid.locations[a] = locations
            parts.append(laid.take(self._apart(a, laid)))
        return States.joined(parts)

    def _free_for(self, a: int, part: States) -> Bools:
        """In which states (locations, n) object a can be where: not in its own frame or that of a held object."""
        layout = self.layout(part)
        held = part.locations == HELD
        fits = np.ones((self.sizes[a], len(part)), dtype=bool)
        carries = (layout.roots == a).sum(axis=0) > 1
        fits[HELD] = ~carries & ~held.any(axis=0) & (self.objects[a] in self.grasps)
        for number, location in enumerate(self.locations[self.objects[a]], start=FIRST_LOCATION):
            root = layout.roots[self.index[location.frame]]
            fits[number] = root != a
            for b in self.movable:
                fits[number] &= ~(held[b] & (root == b))
        return fits

    def _apart(self, a: int, states: States) -> Bools:
        """In which states none of the first objects up to a are within another, and no pile is too high."""
        layout = self.layout(states)
        fits = layout.offsets[LEVEL].max(axis=0, initial=0) <= self.levels
        if not fits.all():
            self.left_out = "; ".join([*self._unseen, _piles(self.levels)])
        for b, c in combinations([number for number in self.movable if number <= a], 2):
            fits &= ~layout.near(b, layout.offsets[:3, c], layout.roots[c], self.parameters.overlap_m)
        return np.asarray(fits)

    def _carried(self, states: States) -> Bools:
        """In which states every object that needs it has something beneath it."""
        hanging = [hangs for _, hangs in self._hanging(states)]
        return np.asarray(~np.any([np.zeros(len(states), bool), *hanging], axis=0))

    def _hanging(self, states: States) -> Iterator[tuple[int, Bools]]:
        """For each location that may need something beneath it, its object and where that lies there without."""
        layout = self.layout(states)
        for a, number, location in self._in_need:
            beside = self._is_beside(location)
            hangs = states.locations[a] == number
            if beside:
                hangs &= self._is_raised(location.frame, layout)
            if hangs.any():
                there, frame = layout.take(hangs), location.frame if beside else None
                hangs[hangs] = ~self._is_carried(a, there.offsets[:3, a], there.roots[a], there, frame)
                yield a, hangs

    @cached_property
    def _in_need(self) -> list[tuple[int, int, Location]]:
        """The locations, with their objects and numbers, that are high, or beside what may be raised."""
        return [
            (a, number, location)
            for a, name in enumerate(self.objects)
            for number, location in enumerate(self.locations[name], start=FIRST_LOCATION)
            if location.frame in (*self.grasps, self.base_frame)
            and (self._height_m(location) > self._upon_m(name, location.frame) or self._is_beside(location))
        ]

    def _upon_m(self, name: str, frame: str) -> float:
        """Up to this height [m] an object lies directly upon that of a frame: its lowest location there, and more
        only by what two of them may differ by.
        """
        heights = [p.position[2] for p in self.locations[name] if p.frame == frame != self.base_frame]
        lowest = min((height for height in heights if height > self.parameters.upon_m[0]), default=np.inf)
        return min(self.parameters.upon_m[1], lowest + self.parameters.alike_m)

    def _height_m(self, location: Location) -> float:
        """How far a location is above the object of its frame [m]; in the base, above the lowest exact one."""
        if location.frame != self.base_frame:
            return location.position[2]
        heights = [
            p.position[2] for known in self.locations.values() for p in known if p.frame == location.frame and p.exact
        ]
        return location.position[2] - min(heights) if location.exact else 0.0

    def _is_beside(self, location: Location) -> bool:
        """Whether what lies at a location stands on what the object of its frame stands on, and must."""
        x, y, z = location.position
        return (
            location.frame in self.grasps
            and location.exact
            and abs(z) < self.parameters.upon_m[0]
            and math.hypot(x, y) > self.parameters.overlap_m
        )

    def _is_raised(self, frame: str, layout: Layout) -> Bools:
        return np.asarray(layout.offsets[RAISED, self.index[frame]] > 0)

    def _upon(self, layout: Layout, a: int, b: int) -> Bools:
        """Where object a lies upon object b."""
        return self._below(layout, b, layout.offsets[:3, a], layout.roots[a], self.parameters.overlap_m)

    def _below(self, layout: Layout, b: int, spot: Floats, root: NDArray[np.int32], radius_m: float) -> Bools:
        """Where b lies as much lower than a spot as one object below another, so near to its vertical."""
        rise, (least_m, most_m) = spot[Z] - layout.offsets[Z, b], self.parameters.upon_m
        return np.asarray((rise > least_m) & (rise < most_m) & layout.near(b, spot, root, radius_m, axes=2))

    def _is_carried(
        self, a: int, spot: Floats, root: NDArray[np.int32], layout: Layout, beside: str | None = None
    ) -> Bools:
        """Whether any object lies right below object a at a spot; `beside` another, one level below that one's."""
        reach_m = self.parameters.support_m if beside else self.parameters.overlap_m
        carried = np.zeros(len(root), dtype=bool)
        for b in self.movable:
            below = self._below(layout, b, spot, root, reach_m)
            if beside:
                below &= layout.offsets[RAISED, b] == layout.offsets[RAISED, self.index[beside]] - 1
            else:
                below &= spot[Z] - layout.offsets[Z, b] < self._upon_m(self.objects[a], self.objects[b])
            carried |= below
        return carried

    # -- leaves ----------------------------------------------------------------------------------------------------

    def holds(self, node: Node, states: States, layout: Layout) -> Bools:
        """In which states (n,) a condition holds."""
        match node.word:
            case GripperIs(state):
                return np.asarray(states.closed == (state == "closed"))
            case InGripper(name):
                free = name == NONE
                return np.asarray((states.locations != HELD).all(axis=0)) if free else self._in_hand(name, states)
            case ObjectAt(name, frame, position, radius_m) | ObjectRoughlyAt(name, frame, position, radius_m) as word:
                root, spot = self._spot(frame, position, layout)
                axes = 3 if isinstance(word, ObjectAt) else 2
                return layout.near(self.index[name], spot, root, radius_m, axes) & ~self._in_hand(name, states)
            case _:
                raise TreeError(f"{node.kind} is no condition")

    def find(self, node: Node, states: States, layout: Layout) -> Ints:
        """Which object (n,) a query finds, NOBODY where it fails; of a pose, the object whose it is."""
        match node.word:
            case FindHeld():
                held = states.locations == HELD
                return np.where(held.any(axis=0), held.argmax(axis=0), NOBODY)
            case FindUpon(name):
                return self._topmost(np.full(len(states), self.index[name]), layout)
            case FindUnder(name):
                return self._under(self.index[name], layout)
            case FindInTheWay(name, frame, position):
                return self._in_the_way({name, *objects_of(frame)}, *self._spot(frame, position, layout), layout)
            case FindSpot(name):
                return np.where(self._in_hand(name, states), self.index[name], NOBODY)
            case FindGrasp(name):
                return np.full(len(states), self.index[name] if name in self.grasps else NOBODY)
            case _:
                raise TreeError(f"{node.kind} is not known to the proof")

    def written(self, node: Node, port: str, number: int) -> Value:
        """What a query writes to a port where it has found the object of a number."""
        name = self.objects[number]
        if node.kind == "FindGrasp":
            grasp = self.grasps[name]
            return grasp.position if port == "position" else grasp.quaternion_xyzw
        if node.kind == "FindSpot":
            return (self.parameters.far_m,) * 3 if port == "position" else IDENTITY_XYZW
        return name

    def _topmost(self, under: Ints, layout: Layout) -> Ints:
        """The highest (n,) of what lies on the vertical of the objects of these numbers (n,), and above them."""
        columns = np.arange(len(under))
        spot, root = layout.offsets[:3, under, columns], layout.roots[under, columns]
        found, highest = np.full(len(under), NOBODY), np.full(len(under), -np.inf)
        for b in self.movable:
            above = layout.near(b, spot, root, self.parameters.overlap_m, axes=2)
            above &= layout.offsets[Z, b] - spot[Z] > self.parameters.upon_m[0]
            above &= layout.offsets[Z, b] > highest
            found[above], highest[above] = b, layout.offsets[Z, b][above]
        return found

    def _under(self, a: int, layout: Layout) -> Ints:
        """The highest (n,) of what an object lies upon."""
        found, highest = np.full(layout.roots.shape[1], NOBODY), np.full(layout.roots.shape[1], -np.inf)
        for b in self.movable:
            under = self._upon(layout, a, b) & (layout.offsets[Z, b] > highest) if b != a else highest > 0
            found[under], highest[under] = b, layout.offsets[Z, b][under]
        return found

    def _in_the_way(self, belonging: Set[str], root: NDArray[np.int32], spot: Floats, layout: Layout) -> Ints:
        """The topmost (n,) of what lies at a spot (3, n), but for what belongs there."""
        found = np.full(len(root), NOBODY)
        for b in self.movable:
            if self.objects[b] not in belonging:
                found[layout.near(b, spot, root, self.parameters.overlap_m)] = b
        topmost = self._topmost(np.maximum(found, 0), layout)
        return np.where((found != NOBODY) & (topmost != NOBODY), topmost, found)

    def _in_hand(self, name: str, states: States) -> Bools:
        return np.asarray(states.locations[self.index[name]] == HELD)

    def _spot(self, frame: str, position: Vector, layout: Layout) -> tuple[NDArray[np.int32], Floats]:
        """Root (n,) and offset (3, n) of a position in a frame."""
        row = self.index[frame]
        return layout.roots[row], layout.offsets[:3, row] + np.array(position, dtype=np.float32)[:, None]

    def ready(self, node: Node, states: States) -> Bools:
        """In which states (n,) the hand is as an action needs it: open for a Pick, else holding what is let go."""
        word = node.word
        if not isinstance(word, Motion):
            return np.ones(len(states), dtype=bool)
        return ~states.closed if word.type == "Pick" else self._in_hand(word.object, states)

    def can(self, node: Node, states: States, layout: Layout) -> Bools:
        """In which states (n,) an action succeeds."""
        fits, word = self.ready(node, states), node.word
        if not isinstance(word, Motion):
            return fits
        a = self.index[word.object]
        if word.type == "Pick":
            for b in self.movable:
                fits = fits & ~self._upon(layout, b, a) if b != a else fits
            return fits
        root, spot = self._spot(word.frame, self._let_go(word), layout)
        for b in self.movable if word.type == "Place" else ():
            if b != a and self.objects[b] != word.frame:
                fits = fits & ~layout.near(b, spot, root, self.parameters.overlap_m)
        return np.asarray(fits & (root != a))

    def after(self, node: Node, states: States, layout: Layout) -> States:
        """The states after an action that succeeded in all of them."""
        locations, closed = states.locations.copy(), states.closed.copy()
        match node.word:
            case SetGripper(state):
                closed[:] = state == "closed"
                if state == "open":
                    locations[locations == HELD] = AWAY
            case Motion(type="Pick", object=name):
                closed[:] = True
                locations[self.index[name]] = HELD
                self._leave_behind(name, locations)
                self._let_fall(States(locations, closed))
            case Motion() as motion:
                closed[:] = False
                reached = self._reached(motion)
                locations[self.index[motion.object]] = np.where(self._falls(motion, reached, layout), AWAY, reached)
        return States(locations, closed)

    def thrown(self, states: States) -> tuple[States, Ints]:
        """Where else what is held may come to rest if the gripper is opened where it is: at any location that is free.

        The states after, and of which of the states each is one.
        """
        parts, of = [states.take(slice(0))], [np.zeros(0, dtype=np.intp)]
        for a in self.movable:
            here = np.flatnonzero(states.locations[a] == HELD)
            empty = states.take(here)
            empty.locations[a], empty.closed[:] = AWAY, False
            columns, locations = np.nonzero(self._free_for(a, empty)[FIRST_LOCATION:].T)
            laid = empty.take(columns)
            laid.locations[a] = locations + FIRST_LOCATION
            fits = self._apart(len(self.objects), laid) & self._carried(laid)
            parts.append(laid.take(fits))
            of.append(here[columns[fits]])
        return States.joined(parts), np.concatenate(of)

    def _leave_behind(self, moved: str, locations: LocationNumbers) -> None:
        """What had its location in the frame of an object that is lifted out has it no longer."""
        for b, name in enumerate(self.objects):
            for number, location in enumerate(self.locations[name], start=FIRST_LOCATION):
                if location.frame == moved:
                    locations[b, locations[b] == number] = AWAY

    def _let_fall(self, states: States) -> None:
        """What has lost what was beneath it is away, with all that had its location in its frame."""
        for a, hangs in self._hanging(states) if self._in_need else ():
            fallen = states.locations[:, hangs]
            fallen[a] = AWAY
            self._leave_behind(self.objects[a], fallen)
            states.locations[:, hangs] = fallen

    def _reached(self, motion: Motion) -> int:
        """The location that a Place or Drop leads to: the nearest location in its frame, else away."""
        let_go, axes = self._let_go(motion), 3 if motion.type == "Place" else 2
        distances = {
            number: float(np.linalg.norm(np.subtract(location.position, let_go)[:axes]))
            for number, location in enumerate(self.locations[motion.object], start=FIRST_LOCATION)
            if location.frame == motion.frame
        }
        nearest = min(distances, key=lambda number: distances[number], default=AWAY)
        near = nearest != AWAY and (motion.type == "Drop" or distances[nearest] < self.parameters.rests_m)
        return nearest if near else AWAY

    def _falls(self, motion: Motion, reached: int, layout: Layout) -> Bools:
        """In which states what is let go has nothing beneath it: it is beside an object that lies upon another."""
        location = self.locations[motion.object][reached - FIRST_LOCATION] if reached != AWAY else None
        if location is None or not self._is_beside(location):
            return np.zeros(layout.roots.shape[1], dtype=bool)
        root, spot = self._spot(motion.frame, location.position, layout)
        return self._is_raised(location.frame, layout) & ~self._is_carried(
            self.index[motion.object], spot, root, layout, location.frame
        )


def _drawn(states: States, count: int, rng: np.random.Generator) -> States:
    """So many of the states, in their order."""
    return states.take(np.sort(rng.permutation(len(states))[:count]))


def _read(node: Node) -> Mapping[str, Value]:
    """The ports that a leaf reads."""
    return {name: value for name, value in node.ports if name not in outputs_of(node.kind)}
