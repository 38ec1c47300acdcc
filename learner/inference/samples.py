"""Demonstrated actions as a table: one row an action, its poses in every candidate frame.

The columns are filled once; what is expressed in a frame is worked out once for all rows; a selection of rows is
again `Samples`, and costs nothing but its row numbers.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from learner.errors import NothingLearnedError
from learner.model import Demonstration, Pose
from learner.model.frame import AXES, BETWEEN, START, midway, objects_of, upright
from learner.model.pose import Array
from learner.model.poses import Mask, Poses, Rows

Names = NDArray[np.str_]
Column = TypeVar("Column")
World = Mapping[str, Poses]
"""By object: its pose in the base, a row each; unknown where it was not seen."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Every action of some demonstrations, in order: n rows, of d demonstrations with one base frame.

    `demonstration` numbers the demonstration (n,) and `step` counts within it; `type` is pick, place or drop and
    `object` what was handled. `end_effector` is its pose in the base at the press, `world` what was known of the
    objects then, `candidates` in which frames the action may be expressed. `rests` is the pose of the released object
    in each frame, unknown for a pick. A row a demonstration have `begins`, what was seen first, `finals`, what was seen
    at the end, and `ends`, the same with what was seen at the beginning alone.
    """

    demonstrations: tuple[Demonstration, ...]
    base: str
    demonstration: Rows
    step: Rows
    type: Names
    object: Names
    relabelled: Mask
    rest_seen: Mask
    end_effector: Poses
    world: World
    candidates: Mapping[str, Mask]
    rests: World
    begins: World
    finals: World
    ends: World
    _derived: dict[Hashable, Any] = field(default_factory=dict)

    @staticmethod
    def of(demonstrations: Sequence[Demonstration]) -> Columns:
        """The table of demonstrations. Raises NothingLearnedError if they differ in their base frame."""
        bases = sorted({demonstration.base_frame for demonstration in demonstrations})
        if len(bases) != 1:
            raise NothingLearnedError(f"the demonstrations differ in their base frame: {', '.join(bases)}")
        actions = [action for demonstration in demonstrations for action in demonstration.actions]
        count = len(actions)
        numbers = np.repeat(np.arange(len(demonstrations)), [len(each.actions) for each in demonstrations])
        candidates = defaultdict(lambda: np.zeros(count, dtype=np.bool_), {bases[0]: np.ones(count, dtype=np.bool_)})
        for row, action in enumerate(actions):
            for frame in action.frames:
                candidates[frame][row] = True
        return Columns(
            demonstrations=tuple(demonstrations),
            base=bases[0],
            demonstration=numbers,
            step=np.array([action.step for action in actions], dtype=np.intp),
            type=np.array([action.type for action in actions], dtype=np.str_),
            object=np.array([action.object for action in actions], dtype=np.str_),
            relabelled=np.array([action.relabelled for action in actions], dtype=np.bool_),
            rest_seen=np.array([action.rest_seen for action in actions], dtype=np.bool_),
            end_effector=Poses.of([action.end_effector for action in actions]),
            world=_world([action.objects for action in actions]),
            candidates=dict(candidates),
            rests=_world([action.rest or {} for action in actions]),
            begins=_world([demonstration.first_seen for demonstration in demonstrations]),
            finals=_world([demonstration.final for demonstration in demonstrations]),
            ends=_world([{**demonstration.initial, **demonstration.final} for demonstration in demonstrations]),
        )

    @cached_property
    def users(self) -> Names:
        """The user of each demonstration (d,)."""
        return np.array([demonstration.user for demonstration in self.demonstrations], dtype=np.str_)

    @cached_property
    def lengths(self) -> Rows:
        """How many actions each demonstration has (d,)."""
        return np.bincount(self.demonstration, minlength=len(self.demonstrations))

    @cached_property
    def handled(self) -> Poses:
        """The pose in the base, at the press, of the object of each action (n,)."""
        found = Poses.unknown(len(self.step))
        for name, poses in self.world.items():
            found = poses.where(self.object == name, found)
        return found

    def once(self, key: Hashable, work: Callable[[], Column]) -> Column:
        """A column that follows from others: worked out at the first question for all rows, whoever selects of them."""
        if key not in self._derived:
            self._derived[key] = work()
        found: Column = self._derived[key]
        return found

    def origin(self, frame: str) -> Poses:
        """The pose of a frame in the base at each press (n,); what an object's own frame goes by, as in CONTRACT 3."""
        return self.once(("origin", frame), lambda: self._origin(frame))

    def _origin(self, frame: str) -> Poses:
        if frame.endswith(START):
            begins = self.begins.get(objects_of(frame)[0], Poses.unknown(len(self.demonstrations)))
            return begins[self.demonstration]
        return posed(frame, self.base, self.world, len(self.step))

    def target(self, frame: str) -> Poses:
        """The end-effector's pose in a frame at each press (n,)."""
        return self.once(("target", frame), lambda: self.origin(frame).inverse() @ self.end_effector)

    def release(self, frame: str) -> Poses:
        """The pose in a frame, at the press, of the object of each action (n,)."""
        return self.once(("release", frame), lambda: self.origin(frame).inverse() @ self.handled)

    @cached_property
    def rest_known(self) -> Mask:
        """Which actions (n,) have a rest pose: releases do, picks do not."""
        return self.rests[self.base].known if self.base in self.rests else np.zeros(len(self.step), dtype=np.bool_)

    def rest(self, frame: str) -> Poses:
        """Where the object came to rest, in a frame (n,). For a pick, where it was."""

        def work() -> Poses:
            return self._resting(frame).where(self.rest_known, self.release(frame))

        return self.once(("rest", frame), work)

    def _resting(self, frame: str) -> Poses:
        """Where the object came to rest, in a frame (n,); of one that goes by several objects, as those were then."""
        if objects_of(frame) == (frame,):
            return self.rests.get(frame, Poses.unknown(len(self.step)))
        return self.origin(frame).inverse() @ self.rests.get(self.base, Poses.unknown(len(self.step)))

    @cached_property
    def fall_m(self) -> Array:
        """How far [m] each object came down from the press to its rest, in the base (n,); NaN if it was not seen."""
        fall = self.handled.positions[:, 2] - self.rest(self.base).positions[:, 2]
        return np.where(self.rest_seen & self.rest_known, fall, np.nan)


@dataclass(frozen=True, eq=False)
class Samples:
    """Some rows of a table of actions: `rows` (m,) of `columns`, of the `numbers` (k,) of its demonstrations.

    Demonstrations are counted among the selected ones, from 0 to k - 1.
    """

    columns: Columns
    rows: Rows
    numbers: Rows

    @staticmethod
    def of(demonstrations: Sequence[Demonstration]) -> Samples:
        """Every action of every demonstration. Raises as Columns.of."""
        columns = Columns.of(demonstrations)
        return Samples(columns, np.arange(len(columns.step)), np.arange(len(columns.demonstrations)))

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, which: Rows | Mask | slice) -> Samples:
        """The samples at some places (numbers, a mask (m,) or a slice) of the same demonstrations."""
        return Samples(self.columns, self.rows[which], self.numbers)

    def of_demonstrations(self, which: Rows | Mask) -> Samples:
        """The samples of some of the demonstrations, which are counted anew."""
        numbers = self.numbers[which]
        return Samples(self.columns, self.rows[np.isin(self.columns.demonstration[self.rows], numbers)], numbers)

    @cached_property
    def demonstrations(self) -> tuple[Demonstration, ...]:
        """The demonstrations (k,)."""
        return tuple(self.columns.demonstrations[number] for number in self.numbers)

    @property
    def users(self) -> Names:
        """The user of each demonstration (k,)."""
        return self.columns.users[self.numbers]

    @cached_property
    def user(self) -> Names:
        """Who showed each sample (m,)."""
        return self.columns.users[self.columns.demonstration[self.rows]]

    @property
    def base(self) -> str:
        """The base frame."""
        return self.columns.base

    @cached_property
    def demonstration(self) -> Rows:
        """The number (m,) of the demonstration of each sample, among the selected ones."""
        return np.searchsorted(self.numbers, self.columns.demonstration[self.rows])

    @property
    def step(self) -> Rows:
        """The number (m,) of each sample in its demonstration; signals and what was taken back leave gaps."""
        return self.columns.step[self.rows]

    @property
    def progress(self) -> Array:
        """How much of its demonstration was done when each sample ended (m,), from 0 to 1."""
        demonstrations = self.columns.demonstration
        place = self.rows - np.searchsorted(demonstrations, demonstrations[self.rows])
        return np.asarray(place / self.columns.lengths[demonstrations[self.rows]])

    @property
    def type(self) -> Names:
        """What each sample was demonstrated as (m,)."""
        return self.columns.type[self.rows]

    @property
    def object(self) -> Names:
        """What each sample handled (m,)."""
        return self.columns.object[self.rows]

    @property
    def relabelled(self) -> Mask:
        """Which samples (m,) a person gave their type afterwards."""
        return self.columns.relabelled[self.rows]

    @property
    def rest_known(self) -> Mask:
        """Which samples (m,) have a rest pose."""
        return self.columns.rest_known[self.rows]

    @property
    def fall_m(self) -> Array:
        """How far [m] each object came down from the press to its rest (m,); NaN if it was not seen."""
        return self.columns.fall_m[self.rows]

    @property
    def frames(self) -> list[str]:
        """Every frame that is a candidate for at least one sample, the base first, then by name."""
        others = (frame for frame, known in self.columns.candidates.items() if frame != self.base)
        return [self.base, *sorted(frame for frame in others if self.candidate(frame).any())]

    @property
    def common_frames(self) -> list[str]:
        """Those that are a candidate for every sample."""
        return [frame for frame in self.frames if self.candidate(frame).all()]

    def candidate(self, frame: str) -> Mask:
        """For which samples (m,) a frame is a candidate; one that goes by objects is where those are."""
        if frame.endswith(START):
            return self.origin(frame).known
        masks = [self.columns.candidates.get(name) for name in objects_of(frame)]
        known = [np.zeros(len(self), dtype=np.bool_) if mask is None else mask[self.rows] for mask in masks]
        return np.asarray(np.logical_and.reduce(known))

    def origin(self, frame: str) -> Poses:
        """The pose in the base, at each press, of a frame (m,)."""
        return self.columns.origin(frame)[self.rows]

    def target(self, frame: str) -> Poses:
        """The end-effector's pose in a frame at each press (m,)."""
        return self.columns.target(frame)[self.rows]

    def release(self, frame: str) -> Poses:
        """The object's pose in a frame at each press (m,)."""
        return self.columns.release(frame)[self.rows]

    def rest(self, frame: str) -> Poses:
        """Where the object came to rest, in a frame (m,). For a pick, where it was."""
        return self.columns.rest(frame)[self.rows]

    def begins(self, name: str) -> Poses:
        """Where an object was first seen in each demonstration (k,), in the base."""
        unknown = Poses.unknown(len(self.columns.demonstrations))
        return self.columns.begins.get(name, unknown)[self.numbers]

    def final(self, name: str) -> Poses:
        """Where an object was seen at the end of each demonstration (k,), in the base; the base at its own origin."""
        return self._at_end(name, self.columns.finals)

    def ends(self, name: str) -> Poses:
        """The same; where it was not seen at the end, as it was at the beginning."""
        return self._at_end(name, self.columns.ends)

    def _at_end(self, name: str, world: World) -> Poses:
        if name.endswith(START):
            return self.begins(objects_of(name)[0])
        return posed(name, self.base, world, len(self.columns.demonstrations))[self.numbers]


def posed(frame: str, base: str, world: World, count: int) -> Poses:
    """The pose in the base of a frame (count,), by the poses of the objects; none that goes by how things began."""
    if frame == base:
        return Poses.identity(count)
    poses = [world.get(name, Poses.unknown(count)) for name in objects_of(frame)]
    if BETWEEN in frame:
        return midway(*poses)
    return upright(poses[0]) if frame.endswith(AXES) else poses[0]


def _world(seen: Sequence[Mapping[str, Pose]]) -> dict[str, Poses]:
    """By name the poses of what was seen (n,)."""
    rows: dict[str, list[int]] = defaultdict(list)
    values: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    for row, poses in enumerate(seen):
        for name, pose in poses.items():
            rows[name].append(row)
            values[name].append((*pose.position, *pose.quaternion_xyzw))
    found = {}
    for name in sorted(rows):
        table = np.full((len(seen), 7), np.nan)
        table[rows[name]] = values[name]
        found[name] = Poses.from_rows(table)
    return found
