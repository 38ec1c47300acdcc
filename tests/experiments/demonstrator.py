"""A simulated demonstrator: does a scenario in the kinematic world and leaves the Recording that a cell would.

recording = demonstrate(SCENARIOS["towers"], np.random.default_rng(1))
demonstrations = demonstrated(SCENARIOS["towers"], count=3, seed=1)
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from learner.model import ActionPress, Demonstration, GripperSample, Recording, Track
from learner.model.pose import Quaternion, multiply
from learner.model.upright import Spot
from learner.observation import observe
from learner.simulation.kinematic_world import NOISELESS, KinematicWorld
from learner.simulation.script import ScriptedMove

from .scenarios import BASE, Scenario
from .users import EXPERT, User

Array = NDArray[np.float64]

START_NS = 1_790_000_000_000_000_000
NS = 1_000_000_000
TOOL = "tool0"
SPEED_M_PER_S = 0.6
ABOVE_M = 0.2
"""The hand travels this far above what it takes or leaves [m]."""
STAND_S, GRIP_S, REST_S = 0.4, 0.3, 0.7
"""The hand stands before a press, waits for the gripper after it, and waits again after it has retreated [s]."""
HAND_OVER_BOX_M = 0.03
"""A drop instead of a place lets go this far above [m]."""
ATTEMPTS = 60


def demonstrated(
    scenario: Scenario, count: int, seed: int, users: Sequence[User] = (EXPERT,), each: bool = False
) -> list[Demonstration]:
    """`count` demonstrations, users taking turns; with `each`, so many of every user."""
    turns = [(user, number) for number in range(count) for user in (users if each else (users[number % len(users)],))]
    return [
        observe(demonstrate(scenario, np.random.default_rng([seed, index]), user, number))
        for index, (user, number) in enumerate(turns)
    ]


def demonstrate(scenario: Scenario, rng: np.random.Generator, user: User = EXPERT, number: int = 0) -> Recording:
    """One demonstration; `number` counts the user's own. What went wrong by chance is done again from the beginning.

    Raises RuntimeError if it goes wrong every time.
    """
    scenario = _as_it_happens(scenario, user)
    for _ in range(ATTEMPTS):
        script = _script(scenario, user, number, rng)
        hand = _Hand(scenario, user, script, rng)
        hand.do()
        if hand.mishap is None and (user.scripts or scenario.reached(hand.world.table.spots, hand.world.held)):
            return hand.recording(number)
    raise RuntimeError(f"{user.name} never manages {scenario.name}; look at the scenario's tolerances")


def _as_it_happens(scenario: Scenario, user: User) -> Scenario:
    if user.coincidence is None:
        return scenario
    name, of, offset = user.coincidence
    return replace(scenario, start=replace(scenario.start, near=(*scenario.start.near, (name, of, offset, 0.0))))


def _script(scenario: Scenario, user: User, number: int, rng: np.random.Generator) -> tuple[ScriptedMove, ...]:
    scripts = user.scripts or scenario.scripts
    steps = scripts[number % len(scripts)]
    if scenario.any_order:
        steps = tuple(steps[index] for index in rng.permutation(len(steps)))
    if user.orders:
        steps = tuple(steps[index] for index in user.orders[number % len(user.orders)])
    verbs = dict(user.verbs)
    return tuple(replace(step, type=verbs.get(step.object, step.type)) for step in steps)


class _Hand:
    """One demonstration under way: the world, the clock, and what the cell's sensors would have told."""

    def __init__(
        self, scenario: Scenario, user: User, script: tuple[ScriptedMove, ...], rng: np.random.Generator
    ) -> None:
        self.scenario, self.user, self.script, self.rng = scenario, user, script, rng
        spots = scenario.draw_start(rng, script)
        self.world = KinematicWorld(scenario.objects, spots, rng, NOISELESS)
        self.now_ns = START_NS
        self.stamps: list[int] = []
        self.poses: dict[str, list[tuple[float, float, float, float]]] = {name: [] for name in (TOOL, *spots)}
        self.gripper: list[GripperSample] = []
        self.presses: list[ActionPress] = []
        self.mishap: str | None = None
        """The first that it met or failed to grasp."""

    def do(self) -> None:
        """All of it."""
        self._tell_gripper()
        self._wait(0.7)
        if self.user.moves_first:
            self._step(self._elsewhere(self.user.moves_first))
        for step in self.script:
            if self.rng.random() < self.user.mistakes:
                self._mistake(step)
            self._step(step)
        self._wait(REST_S)

    def _elsewhere(self, name: str) -> ScriptedMove:
        """Move an object to a free place from which the script is still possible."""
        spots = self.scenario.draw_start(self.rng, self.script)
        return ScriptedMove("place", name, BASE, (spots[name].x, spots[name].y, spots[name].z), spots[name].yaw)

    def _mistake(self, step: ScriptedMove) -> None:
        """Take a wrong object and put it back."""
        table = self.world.table
        wrong = [n for n, b in self.scenario.objects.items()
                 if b.graspable and n not in (step.object, step.frame) and not table.covered(n)]  # fmt: skip
        if wrong:
            name = str(self.rng.choice(sorted(wrong)))
            back = table.spots[name]
            self._step(ScriptedMove("place", name, BASE, (back.x, back.y, back.z), back.yaw))

    def _step(self, step: ScriptedMove) -> None:
        self._wait(float(self.rng.uniform(0.0, self.user.pauses_s)))
        self._pick(step.object)
        self._release(step)

    def _pick(self, name: str) -> None:
        spot = self.world.spot(name)
        yaw = spot.yaw + self._quarters(name)
        self._approach(self._missed(replace(spot, z=spot.z + self.user.grasp_height_m, yaw=yaw)))
        self._press("pick", name)
        self.world.close()
        self.mishap = self.mishap or (None if self.world.held == name else name)
        self._after()

    def _quarters(self, name: str) -> float:
        """Quarter turns that nobody sees."""
        cube = self.scenario.objects[name].shape.symmetry == "cube"
        return float(self.rng.integers(4)) * math.pi / 2 if self.user.quarter_turns and cube else 0.0

    def _release(self, step: ScriptedMove) -> None:
        target = self._target(step)
        held = self.world.hand_spot.relative(self.world.spot(step.object))
        turned = replace(target, z=0.0).compose(replace(_inverse(held), z=0.0))
        self._approach(self._missed(replace(turned, z=target.z - held.z), level=step.type == "place"))
        self.mishap = self.mishap or self.world.met_by_held()
        self._press(step.type, step.object)
        self.world.open()
        self._after()

    def _target(self, step: ScriptedMove) -> Spot:
        """Where the object's origin shall be at the release."""
        frame, now = self.world.spot(step.frame), self.world.spot(step.object)
        there = frame.compose(Spot(*step.at, step.yaw or 0.0))
        turned = 0.0 if self._gives_directions(step.object) else self._quarters(step.object)
        yaw = now.yaw if step.yaw is None else there.yaw + turned
        was_place = any(
            step.object == s.object and s.type == "place" for script in self.scenario.scripts for s in script
        )
        higher = HAND_OVER_BOX_M if step.type == "drop" and was_place else 0.0
        return replace(there, z=there.z + higher, yaw=yaw)

    def _gives_directions(self, name: str) -> bool:
        """Whether something is placed beside it, so that its yaw is no matter of taste."""
        return any(step.frame == name and step.at[:2] != (0.0, 0.0) for step in self.script)

    def _missed(self, spot: Spot, level: bool = False) -> Spot:
        """What the hand makes of it; a place ends when the table or what is below is felt."""
        dx, dy, dz, turn = self.rng.standard_normal(4)
        sigma = self.user.hand_m
        down = abs(dz) if level else dz
        return Spot(
            spot.x + sigma * dx, spot.y + sigma * dy, spot.z + sigma * down, spot.yaw + self.user.hand_rad * turn
        )

    def _approach(self, target: Spot) -> None:
        self._travel(replace(target, z=max(target.z, self.world.hand[2] - ABOVE_M) + ABOVE_M))
        self._travel(target)
        self._wait(STAND_S)

    def _after(self) -> None:
        self.now_ns += NS // 20
        self._tell_gripper()
        self._wait(GRIP_S)
        self._travel(replace(self.world.hand_spot, z=self.world.hand[2] + ABOVE_M))
        self._wait(REST_S if self.world.gripper == "open" else 0.0)

    def _press(self, verb: str, name: str) -> None:
        self._sample()
        self.presses.append(ActionPress(self.now_ns, verb, None if self.user.unnamed else name))

    def _travel(self, to: Spot) -> None:
        begin = self.world.hand_spot
        turn = math.remainder(to.yaw - begin.yaw, 2 * math.pi)
        length = math.dist((begin.x, begin.y, begin.z), (to.x, to.y, to.z))
        count = max(1, math.ceil(length / SPEED_M_PER_S * self.user.rate_hz))
        for part in (index / count for index in range(1, count + 1)):
            position = tuple(b + part * (t - b) for b, t in ((begin.x, to.x), (begin.y, to.y), (begin.z, to.z)))
            self.world.move_hand(position, _tool(begin.yaw + part * turn))  # type: ignore[arg-type]  # three numbers
            self._tick()

    def _wait(self, seconds: float) -> None:
        for _ in range(math.ceil(seconds * self.user.rate_hz)):
            self._tick()

    def _tick(self) -> None:
        self.now_ns += int(NS / self.user.rate_hz)
        if self.now_ns - self.gripper[-1].stamp_ns >= NS:
            self._tell_gripper()
        self._sample()

    def _sample(self) -> None:
        self.stamps.append(self.now_ns)
        for name, series in self.poses.items():
            spot = self.world.hand_spot if name == TOOL else self.world.spot(name)
            series.append((spot.x, spot.y, spot.z, spot.yaw))

    def _tell_gripper(self) -> None:
        state = self.world.gripper
        width = 0.08 if state == "open" else 0.05 if self.world.held else 0.0
        self.gripper.append(GripperSample(self.now_ns, state, width))

    # -- what the cell saw -----------------------------------------------------------------------------------------

    def recording(self, number: int) -> Recording:
        """All that a recorder would have kept."""
        scenario, tracks = self.scenario, dict(self._tracks())
        digest = hashlib.sha256(b"".join(track.positions.tobytes() for track in tracks.values())).hexdigest()
        return Recording(
            demonstration_id=f"{scenario.name}-{self.user.name}-{number}-{digest[:8]}",
            task=scenario.name,
            user=self.user.name,
            cell="kinematic",
            base_frame=BASE,
            end_effector_frame=TOOL,
            objects=tuple(sorted(scenario.objects)),
            outcome="success",
            tracks=tracks,
            gripper=tuple(self.gripper),
            presses=tuple(self.presses),
            sha256=digest,
            start_ns=START_NS,
            messages_lost={"/poses": 0, "/gripper": 0, "/action": 0},
            scene=scenario.scene,
            parents=frozenset({BASE}),
        )

    def _tracks(self) -> Iterator[tuple[str, Track]]:
        stamps = np.array(self.stamps, dtype=np.int64)
        tool = np.array(self.poses[TOOL])
        for name, series in self.poses.items():
            truth = np.array(series)
            quaternions = np.array([_tool(yaw) if name == TOOL else _upright(yaw) for yaw in truth[:, 3]])
            if name == TOOL:
                yield name, Track(stamps, truth[:, :3], quaternions)
                continue
            seen = self._shown(truth, tool)
            positions, turned = self._through_camera(name, truth[seen, :3], quaternions[seen])
            yield name, Track(stamps[seen], positions, turned)

    def _shown(self, truth: Array, tool: Array) -> NDArray[np.bool_]:
        """Which samples the camera has: not those of what the hand hides."""
        distance = np.linalg.norm(truth[:, :3] - tool[:, :3], axis=1)
        return np.asarray(distance >= self.user.hidden_m)

    def _through_camera(self, name: str, positions: Array, quaternions: Array) -> tuple[Array, Array]:
        user, rng, count = self.user, self.rng, len(positions)
        crooked = _turns(np.random.default_rng(list(name.encode())), user.crooked_rad, 1)
        shaken = multiply(multiply(quaternions, crooked), _turns(rng, user.camera_rad, count))
        flipped = rng.random(count) < user.flips
        shaken[flipped] = multiply(shaken[flipped], np.array([1.0, 0.0, 0.0, 0.0]))
        return positions + rng.normal(0.0, user.camera_m, (count, 3)), shaken


def crooked_markers(names: Sequence[str], user: User) -> dict[str, Quaternion]:
    """How the markers of this user's cell are glued: the same at every demonstration and at run time."""
    found = {name: _turns(np.random.default_rng(list(name.encode())), user.crooked_rad, 1)[0] for name in names}
    return {name: (float(q[0]), float(q[1]), float(q[2]), float(q[3])) for name, q in found.items()}


def _turns(rng: np.random.Generator, sigma_rad: float, count: int) -> Array:
    """Random small rotations (count, 4): about a random axis, by a normal angle."""
    axes = rng.standard_normal((count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    half = rng.normal(0.0, sigma_rad, (count, 1)) / 2
    return np.concatenate([axes * np.sin(half), np.cos(half)], axis=1)


def _upright(yaw: float) -> Quaternion:
    return (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def _tool(yaw: float) -> Quaternion:
    """The end-effector with its z pointing down and its x axis at `yaw` in the base."""
    return (math.cos(yaw / 2), math.sin(yaw / 2), 0.0, 0.0)


def _inverse(spot: Spot) -> Spot:
    return spot.relative(Spot(0.0, 0.0, 0.0, 0.0))
