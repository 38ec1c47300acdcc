"""The face of the simulated cell on Zenoh: poses, gripper and skills as CONTRACT.md, sections 1 and 3, say.

Below `treewright/<cell>/sim/` it also answers what a real cell has no answer to, JSON in and out:

    truth     {}                                            true poses, what is held, whether the goal holds
    scene     {}                                            scenario, objects, frames, shapes
    reset     {"seed"?}                                     stand at another random start
    disturb   {"object", "position"?, "orientation"?}       put an object elsewhere; without position anywhere free
              {"object", "away": true}                      take an object off the table, until it is put elsewhere
              {"take_from_gripper": {"position"?, ...}}     take what is held out of the gripper, the same way
              {"skill_failure_rate": p}                     let skills fail by chance from now on
    drag      {"position", "orientation"}                   lead the hand to a pose in the base, as an operator does
    grip      {"state": "open" | "closed"}                  move the fingers where the hand is
"""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
import zenoh

from learner.errors import LearnerError
from learner.model import Pose, check_name
from learner.simulation.cell import skills
from learner.simulation.cell.bodies import UnknownObjectError
from learner.simulation.cell.engine import PERIOD_S
from learner.simulation.cell.physics import World
from learner.simulation.cell.skills import Skill, SkillResult
from learner.simulation.failure import Failure
from learner.simulation.scenarios import BASE, TOOL, sample_spot
from pipelines.network.ownership import owned
from pipelines.profile import Profile
from pipelines.simulated_cell.fields import (
    BadRequestError,
    Fields,
    fields_of,
    object_in,
    pose_in,
    share_in,
    state_in,
    text_in,
)
from pipelines.simulated_cell.showing import Showing

TICK_S: Final = 1 / 60
BURST_S: Final = 0.1
"""The longest time that physics may run before requests are looked at again: a cancelled skill stops within 0.5 s."""
SKILLS: Final = ("Pick", "Place", "Drop", "SetGripper")
SIMULATED: Final = ("truth", "scene", "reset", "disturb", "drag", "grip")


@dataclass(frozen=True)
class Execution:
    """A skill that runs, with the query that waits for its end."""

    execution_id: str
    skill: str
    key: str
    query: zenoh.Query


class Cell:
    """A world that lives on Zenoh under a cell's name. A context manager; `run` lets it live until told to stop.

    `speed` is the world's time in units of the wall's; where the machine is too slow, the world is slower. Stamps
    are of the wall clock. `report` is called with each event, a JSON-able object. Frames are called, and shapes told,
    as in the `profile`, else as the scenario has them. Physics and requests share one thread, that of `run`.
    """

    def __init__(
        self,
        session: zenoh.Session,
        name: str,
        world: World,
        rng: np.random.Generator,
        speed: float = 1.0,
        report: Callable[[Fields], None] = lambda event: None,
        profile: Profile | None = None,
    ) -> None:
        self.name, self.world = check_name("cell", name), world
        self._session, self._rng, self._speed, self._report = session, rng, speed, report
        self._root = f"treewright/{name}"
        self._profile = profile or Profile(BASE, TOOL, world.scenario.scene.to_data())
        self._requests: queue.SimpleQueue[tuple[str, zenoh.Query]] = queue.SimpleQueue()
        self._execution: Execution | None = None
        self._result: SkillResult | None = None
        self._failure_rate = 0.0
        self._role = ExitStack()
        self._answers = {"truth": self._truth, "scene": self._scene, "reset": self._reset, "disturb": self._disturb}

    def __enter__(self) -> Self:
        self._role.enter_context(owned(self._session, f"{self._root}/sim", f"a cell {self.name!r}"))
        self._showing = self._role.enter_context(Showing(self._session, self.name, self.world, self._profile))
        keys = [f"skills/{skill}" for skill in (*SKILLS, "cancel")] + [f"sim/{name}" for name in SIMULATED]
        for key in keys:
            self._role.enter_context(self._declare(key))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop_skill("the cell stops")
        self._role.close()

    def run(self, stop: threading.Event) -> None:
        """Live until `stop` is set; then the running skill is cancelled."""
        last_s, owed_s = time.monotonic(), 0.0
        while not stop.is_set():
            now_s = time.monotonic()
            # What a busy machine could not simulate is forgotten: the world slows down, it does not jump.
            owed_s = min(owed_s + (now_s - last_s) * self._speed, max(BURST_S * self._speed, PERIOD_S))
            last_s = now_s
            self._serve()
            owed_s = self._live(owed_s, now_s + BURST_S)
            self._showing.show()
            self._conclude()
            stop.wait(max(0.0, TICK_S - (time.monotonic() - now_s)))
        self._stop_skill("the cell stops")

    def _live(self, owed_s: float, until_s: float) -> float:
        """Let the world live for what is owed, or until a moment of the wall's; returns what remains owed."""
        while owed_s >= PERIOD_S and time.monotonic() < until_s and self._result is None:
            self.world.step()
            owed_s -= PERIOD_S
        return owed_s

    def _declare(self, key: str) -> zenoh.Queryable[None]:
        def note(query: zenoh.Query) -> None:
            # On Zenoh's own thread, which may not touch the world.
            self._requests.put((key, query))

        return self._session.declare_queryable(f"{self._root}/{key}", note, complete=True)

    def _serve(self) -> None:
        while not self._requests.empty():
            key, query = self._requests.get()
            try:
                self._handle(key, query)
            except (BadRequestError, LearnerError) as error:
                with query:
                    query.reply_err(json.dumps({"error": str(error)}), encoding="application/json")

    def _handle(self, key: str, query: zenoh.Query) -> None:
        kind, name = key.split("/")
        fields = fields_of(query)
        if key == "skills/cancel":
            self._reply(key, query, self._cancel(text_in(fields, "execution_id")))
        elif kind == "skills" or name in ("drag", "grip"):
            self._begin(key, name, fields, query)
        else:
            self._reply(key, query, self._answers[name](fields))

    def _begin(self, key: str, name: str, fields: Fields, query: zenoh.Query) -> None:
        skill = self._skill(name, fields)
        execution_id = text_in(fields, "execution_id") if name in SKILLS else name
        running = self._execution
        if running is not None:
            reason = f"busy: {running.skill} {running.execution_id} is running; one skill at a time"
            self._reply(key, query, {"status": "failure", "reason": reason})
            return
        self._execution = Execution(execution_id, name, key, query)
        self.world.activity = self._perform(self._unless_unlucky(skill) if name in SKILLS else skill)
        self._report({"event": "skill started", "skill": name, "execution_id": execution_id})

    def _perform(self, skill: Skill) -> Any:
        try:
            self._result = yield from skill
        except LearnerError as error:
            self._result = SkillResult(Failure("other", said=str(error)))

    def _unless_unlucky(self, skill: Skill) -> Skill:
        if self._rng.random() >= self._failure_rate:
            return (yield from skill)
        yield
        return SkillResult(Failure("other", said="the skill failed by chance, as it was told to"))

    def _skill(self, name: str, fields: Fields) -> Skill:
        world = self.world
        match name:
            case "Pick":
                return skills.pick(world, text_in(fields, "object"), self._frame(fields), pose_in(fields))
            case "Place" | "Drop":
                return skills.place(world, text_in(fields, "object"), self._frame(fields), pose_in(fields))
            case "drag":
                return skills.move(world, pose_in(fields))
            case _:
                return skills.set_gripper(world, state_in(fields))

    def _frame(self, fields: Fields) -> str:
        """The frame of a request by the name that the world has for it."""
        frame, base = text_in(fields, "frame"), self._profile.base_frame
        if frame == BASE != base:
            raise UnknownObjectError("frame", frame, (base, *self.world.objects))
        return BASE if frame == base else frame

    def _conclude(self) -> None:
        """Answer the request whose skill has ended; what came of it is published before."""
        if self._result is None:
            return
        self._showing.show(at_once=True)
        self._answer(self._result)

    def _answer(self, result: SkillResult) -> None:
        execution, self._execution, self._result = self._execution, None, None
        if execution is None:
            return
        answer = {"status": result.status, "reason": result.reason}
        self._reply(execution.key, execution.query, answer)
        ids = {"skill": execution.skill, "execution_id": execution.execution_id}
        self._report({"event": "skill ended", **ids, **answer})

    def _cancel(self, execution_id: str) -> Fields:
        running = self._execution
        if running is None or running.execution_id != execution_id:
            runs = f"{running.execution_id} is running" if running else "nothing is running"
            return {"status": "failure", "reason": f"no execution {execution_id!r} to cancel: {runs}"}
        self._stop_skill("cancelled")
        return {"status": "success", "reason": None}

    def _stop_skill(self, reason: str) -> None:
        """Stop the arm where it is and the fingers as they are; the request answers failure."""
        if self._execution is None:
            return
        self.world.halt()
        self._answer(self._result or SkillResult(Failure("other", said=reason)))

    def _reply(self, key: str, query: zenoh.Query, answer: Fields) -> None:
        with query:
            query.reply(f"{self._root}/{key}", json.dumps(answer), encoding="application/json")

    def _truth(self, fields: Fields) -> Fields:
        world = self.world
        poses = {name: _to_data(pose) for name, pose in world.poses_in_base().items()}
        return {
            "time_s": round(world.time_s, 4),
            "goal": world.goal.reached,
            "goal_held_s": round(world.goal.held_s(world.time_s), 4),
            "held": world.held,
            "gripper": world.gripper.state,
            "away": sorted(world.bodies.away),
            "poses": {**poses, self._profile.end_effector_frame: _to_data(world.arm.tool_pose)},
        }

    def _scene(self, fields: Fields) -> Fields:
        return {
            "cell": self.name,
            "scenario": self.world.scenario_name or None,
            "objects": self.world.objects,
            "base_frame": self._profile.base_frame,
            "end_effector_frame": self._profile.end_effector_frame,
            "scene": dict(self._profile.scene),
        }

    def _reset(self, fields: Fields) -> Fields:
        seed = fields.get("seed")
        if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int) or seed < 0):
            raise BadRequestError("seed is a whole number from 0")
        self._stop_skill("the world was reset")
        self.world.reset(self._rng if seed is None else np.random.default_rng(seed))
        self._showing.show(at_once=True)
        return self._truth(fields)

    def _disturb(self, fields: Fields) -> Fields:
        if "skill_failure_rate" in fields:
            self._failure_rate = share_in(fields, "skill_failure_rate")
        elif "take_from_gripper" in fields:
            if self.world.held is None:
                raise BadRequestError("nothing is held that could be taken from the gripper")
            self._teleport(self.world.held, object_in(fields["take_from_gripper"]))
        elif fields.get("away") is True:
            self.world.take_away(text_in(fields, "object"))
        else:
            self._teleport(text_in(fields, "object"), fields)
        return self._truth(fields)

    def _teleport(self, name: str, fields: Fields) -> None:
        world = self.world
        present = world.pose_in_base(name)
        if "position" in fields:
            pose = pose_in({"orientation": present.quaternion_xyzw, **fields})
        else:
            others = {other: pose for other, pose in world.poses_in_base().items() if other != name}
            pose = sample_spot(world.scenario, name, others, self._rng)
        world.teleport(name, pose, with_content=fields.get("with_content") is not False)


def _to_data(pose: Pose) -> Fields:
    return {"position": pose.position, "orientation": pose.quaternion_xyzw}
