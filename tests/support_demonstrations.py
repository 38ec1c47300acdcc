"""Made-up demonstrations: one by hand, random ones for property tests, and ones that follow a script.

start = {"A": at(0.4, 0.1), "box": at(0.5, -0.2)}
scripted(start, [Put("A", "box", (0.0, 0.0, 0.02))])
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st

from learner.model import DemonstratedAction, Demonstration, ObjectShape, Pose, Scene
from learner.model.demonstration import ActionType
from learner.model.pose import Vector

TURNED = (0.0, 0.0, math.sin(0.3), math.cos(0.3))


def demonstration(demonstration_id: str = "d1", task: str = "kitting", content: str = "a") -> Demonstration:
    """A pick of A and a drop of it in the box, with everything that a demonstration can hold."""
    box, cube, gripper = Pose((0.4, 0.1, 0.0), TURNED), Pose((0.3, -0.2, 0.025)), Pose((0.3, -0.2, 0.03), TURNED)
    above = Pose((0.41, 0.09, 0.2), TURNED)
    pick = DemonstratedAction(1, 1_700_000_000_000_000_001, "pick", "A", gripper, {"A": cube, "box": box}, ("box", "A"))
    drop = DemonstratedAction(
        step=2,
        stamp_ns=1_700_000_005_000_000_000,
        type="drop",
        object="A",
        end_effector=above,
        objects={"A": above, "box": box},
        frames=("box",),
        rest={"base": Pose((0.4, 0.1, 0.02)), "box": Pose((0.0, 0.01, 0.02))},
        rest_seen=False,
        warnings=("A was not seen at rest.",),
    )
    return Demonstration(
        demonstration_id=demonstration_id,
        task=task,
        user="u1",
        cell="cell-1",
        base_frame="base",
        end_effector_frame="gripper",
        objects=("A", "box"),
        outcome="success",
        actions=(pick, drop),
        sha256=hashlib.sha256(f"{demonstration_id}{content}".encode()).hexdigest(),
        initial={"A": cube, "box": box},
        final={"A": Pose((0.4, 0.1, 0.02)), "box": box},
        start_ns=1_700_000_000_000_000_000,
        messages_lost={"/poses": 0, "/gripper": None},
        scene=Scene({"A": ObjectShape((0.05, 0.05, 0.05), "cube")}, ((0.0, 1.0), (-0.5, 0.5))),
        warnings=("The box jumped.",),
        gaps=("2 messages were lost on /poses near step 1.",),
    )


NAMES = st.sampled_from(["A", "B", "marker_61", "cube-1.b", "base"])
NUMBERS = st.floats(-5, 5)
LENGTHS = st.floats(0.001, 5)
POSES = st.builds(
    lambda position, quaternion: Pose.of(
        position, quaternion if any(abs(q) > 0.1 for q in quaternion) else (0, 0, 0, 1)
    ),
    st.tuples(NUMBERS, NUMBERS, NUMBERS),
    st.tuples(*[st.floats(-1, 1)] * 4),
)
POSES_BY_NAME = st.dictionaries(NAMES, POSES, max_size=3)
SENTENCES = st.lists(st.text(max_size=12), max_size=2).map(tuple)
ACTIONS = st.builds(
    DemonstratedAction,
    step=st.just(0),
    stamp_ns=st.integers(0, 2**62),
    type=st.sampled_from(["pick", "place", "drop"]),
    object=NAMES,
    end_effector=POSES,
    objects=POSES_BY_NAME,
    frames=st.lists(NAMES, unique=True, max_size=3).map(tuple),
    rest=st.none() | POSES_BY_NAME,
    rest_seen=st.booleans(),
    warnings=SENTENCES,
)
DEMONSTRATIONS = st.builds(
    Demonstration,
    demonstration_id=st.sampled_from(["d1", "d2", "d3"]),
    task=st.sampled_from(["t1", "t2"]),
    user=NAMES,
    cell=NAMES,
    base_frame=st.just("base"),
    end_effector_frame=NAMES,
    objects=st.lists(NAMES, max_size=3).map(tuple),
    outcome=st.sampled_from(["success", "failure", "unknown"]),
    actions=st.lists(ACTIONS, max_size=3).map(
        lambda actions: tuple(replace(action, step=step) for step, action in enumerate(actions))
    ),
    sha256=st.just("0" * 64),
    initial=POSES_BY_NAME,
    final=POSES_BY_NAME,
    start_ns=st.none() | st.integers(0, 2**62),
    messages_lost=st.none() | st.dictionaries(NAMES, st.none() | st.integers(0, 9), max_size=2),
    scene=st.none()
    | st.builds(
        Scene,
        st.dictionaries(NAMES, st.builds(ObjectShape, st.tuples(LENGTHS, LENGTHS, LENGTHS)), max_size=2),
        st.none() | st.just(((0.0, 1.0), (-0.5, 0.5))),
    ),
    warnings=SENTENCES,
    gaps=SENTENCES,
)


BASE, TOOL = "base", "tool0"
ORIGIN = Pose((0.0, 0.0, 0.0))
CUBE_M = 0.05
TABLE_M = CUBE_M / 2
"""Height of a cube's origin on the table."""
ON_TOP: Vector = (0.0, 0.0, CUBE_M)
GRASP = Pose((0.0, 0.0, 0.01), (1.0, 0.0, 0.0, 0.0))
"""The hand in a cube's frame, from above."""
NS = 1_000_000_000


def turned(yaw: float) -> tuple[float, float, float, float]:
    """The quaternion xyzw of a turn [rad] about the vertical."""
    return (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def at(x: float, y: float, z: float = TABLE_M, yaw: float = 0.0) -> Pose:
    """An upright pose in the base."""
    return Pose((x, y, z), turned(yaw))


@dataclass(frozen=True)
class Put:
    """Pick `object`, and release it `fall_m` above where it comes to rest: `at` in `frame`, turned by `yaw` there."""

    object: str
    frame: str
    at: Vector
    type: ActionType = "place"
    fall_m: float = 0.0
    yaw: float = 0.0
    grasp: Pose = GRASP


@dataclass(frozen=True)
class Take:
    """Pick `object` and keep it."""

    object: str
    grasp: Pose = GRASP


@dataclass(frozen=True)
class Shove:
    """Somebody sets `object` down at a pose in the base, together with `content`, by hand."""

    object: str
    to: Pose
    content: tuple[str, ...] = ()


Script = Sequence[Put | Take | Shove]


class _Bench:
    """A table on which a script is done, seen by a noisy camera and done by an unsteady hand."""

    def __init__(self, start: Mapping[str, Pose], rng: np.random.Generator | None, hand_m: float, camera_m: float):
        self.poses, self.rng, self.hand_m, self.camera_m = dict(start), rng, hand_m, camera_m
        self.actions: list[DemonstratedAction] = []

    def do(self, item: Put | Take | Shove) -> None:
        if isinstance(item, Shove):
            self._shove(item)
            return
        hand = self._off(self.poses[item.object] @ item.grasp, self.hand_m)
        grasp = self.poses[item.object].inverse() @ hand
        self._press("pick", item.object, hand)
        if isinstance(item, Put):
            self._release(item, grasp)

    def _shove(self, item: Shove) -> None:
        before = self.poses[item.object]
        for name in (item.object, *item.content):
            self.poses[name] = item.to @ before.inverse() @ self.poses[name]

    def _release(self, item: Put, grasp: Pose) -> None:
        wanted = self._frame(item.frame) @ Pose(item.at, turned(item.yaw))
        rest = self._off(wanted, self.hand_m)
        above = Pose((rest.position[0], rest.position[1], rest.position[2] + item.fall_m), rest.quaternion_xyzw)
        self.poses[item.object] = above
        pressed = self._press(item.type, item.object, above @ grasp)
        self.poses[item.object] = rest
        seen = self.seen()
        frames = {BASE: ORIGIN, **{name: seen[name] for name in pressed.frames}}
        rests = {frame: pose.inverse() @ seen[item.object] for frame, pose in frames.items()}
        self.actions[-1] = replace(pressed, rest=rests)

    def _press(self, kind: ActionType, name: str, hand: Pose) -> DemonstratedAction:
        step, seen = len(self.actions), self.seen()
        frames = tuple(sorted(other for other in seen if kind == "pick" or other != name))
        self.actions.append(DemonstratedAction(step, (step + 1) * 5 * NS, kind, name, hand, seen, frames))
        return self.actions[-1]

    def _frame(self, name: str) -> Pose:
        return ORIGIN if name == BASE else self.poses[name]

    def seen(self) -> dict[str, Pose]:
        return {name: self._off(pose, self.camera_m) for name, pose in self.poses.items()}

    def _off(self, pose: Pose, sigma_m: float) -> Pose:
        if self.rng is None:
            return pose
        return Pose.of(np.array(pose.position) + self.rng.normal(0.0, sigma_m, 3), pose.quaternion_xyzw)


def scripted(
    start: Mapping[str, Pose],
    script: Script,
    demonstration_id: str = "d1",
    user: str = "u1",
    rng: np.random.Generator | None = None,
    hand_m: float = 0.003,
    camera_m: float = 0.0015,
    scene: Scene | None = None,
) -> Demonstration:
    """What was demonstrated by doing a script from a start; without `rng` hand and camera are exact."""
    bench = _Bench(start, rng, hand_m, camera_m)
    initial = bench.seen()
    for item in script:
        bench.do(item)
    return Demonstration(
        demonstration_id=demonstration_id,
        task="task",
        user=user,
        cell="cell",
        base_frame=BASE,
        end_effector_frame=TOOL,
        objects=tuple(start),
        outcome="success",
        actions=tuple(bench.actions),
        sha256=hashlib.sha256(demonstration_id.encode()).hexdigest(),
        initial=initial,
        final=bench.seen(),
        scene=scene,
    )


def scattered(names: Sequence[str], rng: np.random.Generator, apart_m: float = 0.15) -> dict[str, Pose]:
    """Objects anywhere on the table at any yaw, none nearer to another than `apart_m`."""
    poses: dict[str, Pose] = {}
    while len(poses) < len(names):
        x, y, yaw = rng.uniform([0.2, -0.5, -math.pi], [0.8, 0.5, math.pi])
        if all(math.dist((x, y), pose.position[:2]) > apart_m for pose in poses.values()):
            poses[names[len(poses)]] = at(float(x), float(y), yaw=float(yaw))
    return poses


def repeated(
    names: Sequence[str],
    scripts: Sequence[Script],
    seed: int = 0,
    scene: Scene | None = None,
    users: Sequence[str] = ("u1",),
) -> list[Demonstration]:
    """One demonstration for each script, each from a scattered start, users taking turns."""
    rng = np.random.default_rng(seed)
    return [
        scripted(scattered(names, rng), script, f"d{number:03}", users[number % len(users)], rng, scene=scene)
        for number, script in enumerate(scripts)
    ]


def hanoi(disks: str = "DEF", pegs: str = "PQR") -> list[Put]:
    """The moves that bring a tower of `disks`, the topmost first, from the first peg to the second."""
    towers: dict[str, list[str]] = {peg: [] for peg in pegs}
    towers[pegs[0]] = list(disks)
    moves: list[Put] = []

    def carry(count: int, source: str, to: str, spare: str) -> None:
        if count == 0:
            return
        carry(count - 1, source, spare, to)
        below = towers[to][0] if towers[to] else to
        moves.append(Put(towers[source].pop(0), below, ON_TOP if towers[to] else (0.0, 0.0, TABLE_M)))
        towers[to].insert(0, moves[-1].object)
        carry(count - 1, spare, to, source)

    carry(len(disks), *pegs)
    return moves


def hanoi_start(rng: np.random.Generator, disks: str = "DEF", pegs: str = "PQR") -> dict[str, Pose]:
    """Pegs anywhere (marks on the table), all disks on the first."""
    poses = {
        name: Pose((*pose.position[:2], 0.0), pose.quaternion_xyzw) for name, pose in scattered(pegs, rng, 0.2).items()
    }
    for level, disk in enumerate(reversed(disks)):
        poses[disk] = poses[pegs[0]] @ Pose((0.0, 0.0, TABLE_M + level * CUBE_M))
    return poses
