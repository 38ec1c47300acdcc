"""A cell without physics on loopback Zenoh: it keeps the contract's word on poses, gripper and skills, and no more.

The end-effector flies straight to its target; what is grasped moves with it; what is released stays where it is, a
drop falls to the table. Tests reach into it: they move objects, hide them, make skills fail, or silence it.
"""

from __future__ import annotations

import json
import socket
import threading
import time
from collections import deque
from types import TracebackType
from typing import Any, Self

import numpy as np
import zenoh
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from learner.model.pose import Pose

SKILLS = ("Pick", "Place", "Drop", "SetGripper")
STEP_S = 0.02
NEAR_M = 0.05
DOWN = (1.0, 0.0, 0.0, 0.0)


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def session_on(endpoint: str, role: str) -> zenoh.Session:
    """A session that listens on, or connects to ('listen', 'connect'), one loopback endpoint and nothing else."""
    config = zenoh.Config()
    config.insert_json5(f"{role}/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    return zenoh.open(config)


class Skill:
    """A request that the arm is working on."""

    def __init__(self, name: str, query: zenoh.Query) -> None:
        self.name, self.query = name, query
        self.ports: dict[str, Any] = json.loads(bytes(query.payload))
        self.started_s = time.monotonic()

    def answer(self, status: str, reason: str = "") -> None:
        with self.query as query:
            query.reply(query.key_expr, json.dumps({"status": status, "reason": reason}))


class KinematicCell:
    """`objects` by name with their poses in the base frame `base`; the end-effector frame is `tool`."""

    def __init__(self, session: zenoh.Session, name: str = "c1", speed_m_s: float = 2.0, **objects: Pose) -> None:
        self.objects = dict(objects)
        self.hand = Pose((0.0, 0.0, 0.5), DOWN)
        self.gripper = "open"
        self.held: str | None = None
        self.speed_m_s = speed_m_s
        self.parent = "base"
        self.hidden: set[str] = set()
        self.skew_ns = 0
        """By so much its clock is wrong [ns]."""
        self.near_m = NEAR_M
        """So far from the hand it grasps what it is to pick [m]."""
        self.mute = False
        """Publishes no poses."""
        self.deaf = False
        """Takes requests and never answers."""
        self.fail_next: deque[str] = deque()
        """Reasons for which the next skills fail."""
        self.requests: list[tuple[str, dict[str, Any]]] = []
        self.cancelled: list[tuple[str, float]] = []
        """Execution ids with the time (monotonic) of their cancellation."""
        self._grasp = Pose((0.0, 0.0, 0.0))
        self._skill: Skill | None = None
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._session, self._prefix = session, f"treewright/{name}"
        self._gripper_told_s = 0.0
        self._thread = threading.Thread(target=self._live, name="kinematic cell", daemon=True)

    def __enter__(self) -> Self:
        self._poses = self._session.declare_publisher(f"{self._prefix}/poses")
        self._gripper = self._session.declare_publisher(f"{self._prefix}/gripper")
        self._queryables = [self._offer(skill) for skill in SKILLS]
        self._queryables.append(self._session.declare_queryable(f"{self._prefix}/skills/cancel", self._cancel))
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        for queryable in self._queryables:
            queryable.undeclare()

    def move(self, name: str, pose: Pose) -> None:
        """Somebody takes an object, out of the gripper if need be, and puts it elsewhere."""
        with self._lock:
            self.objects[name] = pose
            if self.held == name:
                self.held = None

    def wait_for_request(self, count: int = 1, limit_s: float = 20.0) -> None:
        """Until so many skills were asked for."""
        deadline_s = time.monotonic() + limit_s
        while len(self.requests) < count:
            assert time.monotonic() < deadline_s, f"only {len(self.requests)} of {count} skills were asked for"
            time.sleep(0.01)

    def _offer(self, name: str) -> Any:
        def take(query: zenoh.Query) -> None:
            self._take(Skill(name, query))

        return self._session.declare_queryable(f"{self._prefix}/skills/{name}", take)

    def _take(self, skill: Skill) -> None:
        with self._lock:
            self.requests.append((skill.name, skill.ports))
            if self._skill is not None:
                skill.answer("failure", "busy")
            elif self.fail_next:
                skill.answer("failure", self.fail_next.popleft())
            elif skill.name == "Pick" and self.gripper == "closed":
                skill.answer("failure", "the gripper is closed")
            else:
                self._skill = skill

    def _cancel(self, query: zenoh.Query) -> None:
        execution_id = json.loads(bytes(query.payload))["execution_id"]
        with self._lock, query:
            self.cancelled.append((execution_id, time.monotonic()))
            if self._skill and self._skill.ports["execution_id"] == execution_id and not self.deaf:
                self._skill.answer("failure", "cancelled")
                self._skill = None
            query.reply(query.key_expr, "{}")

    def _live(self) -> None:
        while not self._stop.wait(STEP_S):
            with self._lock:
                if self._skill and not self.deaf:
                    self._work(self._skill)
                self._publish()

    def _work(self, skill: Skill) -> None:
        if skill.name == "SetGripper":
            self._grip(skill.ports["state"])
            self._end(skill, "success")
        elif self._approach(self._target(skill)):
            self._arrive(skill)

    def _target(self, skill: Skill) -> Pose:
        frame = skill.ports["frame"]
        target = Pose.of(skill.ports["position"], skill.ports["orientation"])
        return target if frame == "base" else self.objects[frame] @ target

    def _approach(self, target: Pose) -> bool:
        way = np.array(target.position) - np.array(self.hand.position)
        distance = float(np.linalg.norm(way))
        share = min(1.0, self.speed_m_s * STEP_S / distance) if distance > 0 else 1.0
        self._move_hand(Pose.of(np.array(self.hand.position) + share * way, target.quaternion_xyzw))
        return share == 1.0

    def _move_hand(self, pose: Pose) -> None:
        self.hand = pose
        if self.held:
            self.objects[self.held] = pose @ self._grasp

    def _arrive(self, skill: Skill) -> None:
        wanted = skill.ports["object"]
        if skill.name == "Pick":
            self._grip("closed")
            fits = self.held == wanted
        else:
            fits = self.held == wanted
            if fits:
                self._grip("open")
            if fits and skill.name == "Drop":
                at = self.objects[wanted]
                self.objects[wanted] = Pose((*at.position[:2], 0.0), at.quaternion_xyzw)
        self._end(skill, "success" if fits else "failure", "" if fits else f"{wanted} is not held")

    def _end(self, skill: Skill, status: str, reason: str = "") -> None:
        self._skill = None
        skill.answer(status, reason)

    def _grip(self, state: str) -> None:
        if state == self.gripper:
            return
        self.gripper, self.held = state, self._nearest() if state == "closed" else None
        if self.held:
            self._grasp = self.hand.inverse() @ self.objects[self.held]
        self._publish()

    def _nearest(self) -> str | None:
        distances = {
            name: float(np.linalg.norm(np.subtract(pose.position, self.hand.position)))
            for name, pose in self.objects.items()
        }
        nearest = min(distances, key=distances.__getitem__, default=None)
        return nearest if nearest is not None and distances[nearest] <= self.near_m else None

    def _publish(self) -> None:
        if self.mute:
            return
        stamp_ns = time.time_ns() + self.skew_ns
        message = FrameTransforms()
        for child, pose in {**self.objects, "tool": self.hand}.items():
            if child not in self.hidden:
                _add(message, self.parent, child, stamp_ns, pose)
        self._poses.put(message.SerializeToString(), encoding="application/protobuf;foxglove.FrameTransforms")
        gripper = json.dumps({"stamp_ns": stamp_ns, "state": self.gripper, "width_m": None})
        self._gripper.put(gripper, encoding="application/json;treewright.GripperState")


def _add(message: FrameTransforms, parent: str, child: str, stamp_ns: int, pose: Pose) -> None:
    transform = message.transforms.add(parent_frame_id=parent, child_frame_id=child)
    transform.timestamp.FromNanoseconds(stamp_ns)
    for vector, names, values in (
        (transform.translation, "xyz", pose.position),
        (transform.rotation, "xyzw", pose.quaternion_xyzw),
    ):
        for name, value in zip(names, values, strict=True):
            setattr(vector, name, value)
