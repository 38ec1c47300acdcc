"""An operator made of a script: leads the hand of the simulated cell through a scenario and presses the buttons.

It does what a person does, over Zenoh alone: `sim/drag` and `sim/grip` stand for the hand on the arm, everything else
is the contract's: `recorder/start`, presses on `action`, `recorder/stop`. It varies as a person does: the start is
random, the hand misses by some millimetres, the order and the pauses differ.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import zenoh

from learner.model import Pose
from learner.simulation.cell.arm_kinematics import pointing_down
from learner.simulation.scenarios import BASE, TOOL, Scenario, scenario_named
from learner.simulation.script import ScriptedMove
from pipelines.errors import CommandError, UnreachableError
from pipelines.network.publisher import declare_publisher
from pipelines.network.question import ask
from pipelines.simulated_cell.hand import DRAG_LIMIT_S, yaw_of
from recorder.wire import ACTION_ENCODING, action_message

QUARTER_TURNS: Final = (0, 1, -1, 2)


class DemonstrationFailedError(CommandError):
    """The scripted operator could not do what the scenario says; nothing was recorded."""


@dataclass(frozen=True)
class Behavior:
    """How much a person varies: standard deviations of the hand, and ranges of pauses [s] of the wall's time.

    `settle_s` is waited after a release, so that the object is seen at rest before the hand moves on.
    """

    hand_m: float = 0.003
    hand_rad: float = math.radians(1.5)
    pause_s: tuple[float, float] = (0.1, 0.5)
    settle_s: float = 0.7
    presses_name_object: bool = True


def demonstrate_scenario(
    session: zenoh.Session,
    cell: str,
    scenario_name: str,
    task: str,
    user: str,
    rng: np.random.Generator,
    behavior: Behavior | None = None,
) -> dict[str, Any]:
    """Demonstrate a scenario once from a new random start, recorded by the cell's recorder; returns its stop reply.

    The outcome told to the recorder is the world's truth. Raises DemonstrationFailedError if the hand is blocked
    (then the recording is discarded), UnreachableError if cell or recorder do not answer.
    """
    operator = ScriptedOperator(session, cell, scenario_named(scenario_name), rng, behavior or Behavior())
    operator.reset()
    with operator.recording(task, user) as reply:
        operator.perform()
    return reply


class ScriptedOperator:
    """One operator at one cell: what its hands and eyes do, and its behavior."""

    def __init__(
        self, session: zenoh.Session, cell: str, scenario: Scenario, rng: np.random.Generator, behavior: Behavior
    ) -> None:
        self._session, self._root = session, f"treewright/{cell}"
        self._scenario, self._rng, self._behavior = scenario, rng, behavior
        self._turn_of_grasp = 0

    def reset(self) -> None:
        """Let the cell stand at a new random start."""
        self._ask("sim/reset", {"seed": int(self._rng.integers(2**31))})

    @contextmanager
    def recording(self, task: str, user: str) -> Iterator[dict[str, Any]]:
        """Record what happens inside the block; the dictionary given receives the recorder's reply to stop.

        An exception inside discards the recording, and so does a press that contradicts what the recorder saw.
        """
        scene = self._ask("sim/scene", {})
        kept = {name: scene[name] for name in ("objects", "base_frame", "end_effector_frame", "scene")}
        self._ask("recorder/start", {"task": task, "user": user, **kept})
        reply: dict[str, Any] = {}
        try:
            self._pause()
            yield reply
        except BaseException:
            self._ask("recorder/discard", {})
            raise
        reply.update(self._stop())

    def _stop(self) -> dict[str, Any]:
        """Raises DemonstrationFailedError where the recorder takes no success for it."""
        try:
            return self._ask("recorder/stop", {"outcome": self._outcome()}, timeout_s=60.0)
        except UnreachableError:
            raise
        except CommandError as error:
            self._ask("recorder/discard", {})
            raise DemonstrationFailedError(str(error)) from error

    def perform(self) -> None:
        """Do the scenario's steps in one of the orders in which people do them."""
        orders = self._scenario.step_orders()
        key = f"{self._root}/action"
        with declare_publisher(self._session, key, ACTION_ENCODING, rate_hz=10.0) as self._action:
            for index in orders[int(self._rng.integers(len(orders)))]:
                self._pick(self._scenario.steps[index].object)
                self._release(self._scenario.steps[index])

    def _pick(self, name: str) -> None:
        cube = self._poses()[name]
        for turn in QUARTER_TURNS:
            reason = self._drag(self._with_hand_noise(_over(cube.position, yaw_of(cube) + turn * math.pi / 2)))
            if reason is None:
                break
        else:
            raise DemonstrationFailedError(f"{name} cannot be grasped: {reason}")
        self._turn_of_grasp = turn
        self._press("pick", name)
        self._grip("closed")
        held = self._truth()["held"]
        if held != name:
            raise DemonstrationFailedError(f"the fingers closed on {held or 'nothing'} instead of {name}")

    def _release(self, step: ScriptedMove) -> None:
        poses = self._poses()
        frame = Pose((0.0, 0.0, 0.0)) if step.frame == BASE else poses[step.frame]
        spread = [*self._rng.uniform(-step.spread_m, step.spread_m, 2), 0.0]
        target = frame.apply(np.add(step.at, spread))
        yaw = yaw_of(frame) + self._turn_of_grasp * math.pi / 2
        # The hand comes to where it has the object at the target, whatever way it holds it.
        shift = np.subtract(poses[TOOL].position, poses[step.object].position)
        turned = _turned(shift, yaw - yaw_of(poses[TOOL]))
        reason = self._drag(self._with_hand_noise(_over(np.add(target, turned), yaw)))
        if reason is not None:
            raise DemonstrationFailedError(f"{step.object} cannot be brought to {step.frame}: {reason}")
        self._press(step.type, step.object)
        self._grip("open")
        time.sleep(self._behavior.settle_s)

    def _press(self, kind: str, name: str) -> None:
        self._pause()
        named = name if self._behavior.presses_name_object else None
        self._action.put(action_message(time.time_ns(), kind, object=named))
        # A button is pressed before the fingers move, and the two are not one movement.
        self._pause()

    def _drag(self, target: Pose) -> str | None:
        """Lead the hand to a pose in the base; returns what it met on the way, None on arrival."""
        request = {"position": target.position, "orientation": target.quaternion_xyzw}
        reply = self._ask("sim/drag", request, DRAG_LIMIT_S)
        return None if reply["status"] == "success" else str(reply["reason"])

    def _grip(self, state: str) -> None:
        reply = self._ask("sim/grip", {"state": state}, DRAG_LIMIT_S)
        if reply["status"] != "success":
            raise DemonstrationFailedError(f"the fingers did not become {state}: {reply['reason']}")

    def _outcome(self) -> str:
        return "success" if self._truth()["goal"] else "failure"

    def _truth(self) -> dict[str, Any]:
        return self._ask("sim/truth", {})

    def _poses(self) -> Mapping[str, Pose]:
        poses = self._truth()["poses"]
        return {name: Pose.of(pose["position"], pose["orientation"]) for name, pose in poses.items()}

    def _with_hand_noise(self, target: Pose) -> Pose:
        position = np.add(target.position, self._rng.normal(0.0, self._behavior.hand_m, 3))
        return _over(position, yaw_of(target) + float(self._rng.normal(0.0, self._behavior.hand_rad)))

    def _pause(self) -> None:
        time.sleep(float(self._rng.uniform(*self._behavior.pause_s)))

    def _ask(self, key: str, fields: Mapping[str, Any], timeout_s: float = 10.0) -> dict[str, Any]:
        return ask(self._session, f"{self._root}/{key}", fields, timeout_s)


def _over(position: Sequence[float] | np.ndarray[Any, Any], yaw_rad: float) -> Pose:
    x, y, z = (float(value) for value in position)
    return pointing_down(x, y, z, yaw_rad)


def _turned(vector: np.ndarray[Any, Any], angle_rad: float) -> np.ndarray[Any, Any]:
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    x, y, z = vector
    return np.array([cosine * x - sine * y, sine * x + cosine * y, z])
