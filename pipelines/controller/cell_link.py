"""A controller's end of a cell's network: what the cell publishes, taken in between two ticks, and its skills.

Zenoh's threads only queue; everything is decoded and judged on the caller's thread, so that a tick sees one state.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final, Literal, Self

import zenoh
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.message import DecodeError

from learner.errors import ModelError
from learner.execution.perception import CellState
from learner.model.pose import Pose
from learner.model.stamps import Timeline
from learner.model.vocabulary import ACTIONS
from pipelines.errors import UnreachableError
from recorder.errors import PayloadError
from recorder.wire import parse_signal

REPLY_LIMIT_S: Final = 600.0
"""A skill that has not answered after this long [s] never will."""
CANCEL_REPLY_LIMIT_S: Final = 2.0
QUEUE_LENGTH: Final = 20_000
"""Samples kept between two ticks; beyond it the oldest go, and the newest state is kept."""

SIGNALS: Final = "signals/"
GRIPPER: Final = "the gripper"
"""Its name among the senders of stamps: no object or frame can be called so."""
Arrival = tuple[int, bytes]
"""When a message arrived, by a clock that does not jump [ns], and its payload."""
SkillStatus = Literal["success", "failure", "silence"]


@dataclass(frozen=True)
class Answer:
    """What became of a skill: its `status` and the cell's `reason`. 'silence' is a query that ended without answer."""

    status: SkillStatus
    reason: str


class CellLink:
    """The subscriptions and queries of one controller to one cell; open within a `with` block.

    `state` is what was seen. `hand_received_s` is when (time.monotonic) the end-effector was last seen anew; `parents`
    the frames in which poses came that are not the base frame; `complaints` what the cell published against the
    contract, a sentence each. Stamps are taken on one timeline (learner.model.stamps), so that no clock that is set,
    and no stamp that is wrong for a moment, leaves the state as it was for good.
    """

    def __init__(self, session: zenoh.Session, cell: str, state: CellState) -> None:
        self.cell, self.state = cell, state
        self.hand_received_s: float | None = None
        self.parents: set[str] = set()
        self.complaints: list[str] = []
        self._session, self._prefix = session, f"treewright/{cell}"
        self._poses: deque[Arrival] = deque(maxlen=QUEUE_LENGTH)
        self._gripper: deque[Arrival] = deque(maxlen=QUEUE_LENGTH)
        self._signals: deque[tuple[str, Arrival]] = deque(maxlen=QUEUE_LENGTH)
        self._timeline: Timeline[Any] = Timeline()
        self._queriers: dict[str, zenoh.Querier] = {}
        self._open = ExitStack()

    def __enter__(self) -> Self:
        for name, queue in (("poses", self._poses), ("gripper", self._gripper)):
            subscriber = self._session.declare_subscriber(f"{self._prefix}/{name}", _into(queue))
            self._open.enter_context(subscriber)
        signals = self._session.declare_subscriber(f"{self._prefix}/{SIGNALS}*", _into_signals(self._signals))
        self._open.enter_context(signals)
        for skill in ACTIONS:
            self._declare(skill, REPLY_LIMIT_S)
        self._declare("cancel", CANCEL_REPLY_LIMIT_S)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._open.close()

    def _declare(self, skill: str, limit_s: float) -> None:
        querier = self._session.declare_querier(
            f"{self._prefix}/skills/{skill}",
            timeout=limit_s,
            consolidation=zenoh.ConsolidationMode.NONE,  # the first reply at once, not when the query is over
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
        self._queriers[skill] = self._open.enter_context(querier)

    def take_in(self) -> None:
        """Bring `state` up to what has arrived."""
        while self._poses:
            self._take_poses(*self._poses.popleft())
        while self._gripper:
            self._take_gripper(*self._gripper.popleft())
        while self._signals:
            name, arrival = self._signals.popleft()
            self._take_signal(name, *arrival)

    def _take_poses(self, arrived_ns: int, payload: bytes) -> None:
        try:
            message = FrameTransforms.FromString(payload)
        except DecodeError:
            self._complain("a message on poses that is no foxglove.FrameTransforms")
            return
        for transform in message.transforms:
            self._take_transform(transform, arrived_ns)
        self._tell_of_clocks()

    def _take_transform(self, transform: Any, arrived_ns: int) -> None:
        child, parent = transform.child_frame_id, transform.parent_frame_id
        if parent != self.state.base_frame:
            self.parents.add(parent)
            return
        at, turn = transform.translation, transform.rotation
        try:
            pose = Pose((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))
        except ModelError as error:
            self._complain(f"a pose of {child!r} that is none: {error}")
            return
        stamp_ns = transform.timestamp.ToNanoseconds()
        for moved_ns, each in self._timeline.take(child, stamp_ns, arrived_ns, pose):
            newer = self.state.update_pose(child, moved_ns, each)
            if newer and child == self.state.end_effector_frame:
                self.hand_received_s = time.monotonic()

    def _tell_of_clocks(self) -> None:
        """Say what the timeline has found, and forget a sighting whose stamp turned out wrong."""
        while self._timeline.strays:
            stray = self._timeline.strays.pop(0)
            self.state.forget(str(stray.sender), stray.stamp_ns)
            off_s = stray.off_ns / 1e9
            self._complain(f"a stamp of {stray.sender!r} that is off by {off_s:+.1f} s; it is left out")
        while self._timeline.steps:
            step = self._timeline.steps.pop(0)
            self._complain(f"stamps of {step.sender!r} by a clock that was set by {step.jump_ns / 1e9:+.1f} s")

    def _take_gripper(self, arrived_ns: int, payload: bytes) -> None:
        try:
            sample = json.loads(payload)
            stamp_ns, state = int(sample["stamp_ns"]), sample["state"]
        except (ValueError, KeyError, TypeError):
            self._complain("a message on gripper without stamp_ns and state")
            return
        if state not in ("open", "closed"):
            self._complain(f"a gripper that is {state!r} instead of open or closed")
            return
        for moved_ns, each in self._timeline.take(GRIPPER, stamp_ns, arrived_ns, state):
            self.state.update_gripper(moved_ns, each)
        self._tell_of_clocks()

    def _take_signal(self, name: str, arrived_ns: int, payload: bytes) -> None:
        try:
            stamp_ns, value = parse_signal(payload)
        except PayloadError as error:
            self._complain(f"a message on {SIGNALS}{name} that {error}")
            return
        for moved_ns, each in self._timeline.take(f"{SIGNALS}{name}", stamp_ns, arrived_ns, value):
            self.state.update_signal(name, moved_ns, each)
        self._tell_of_clocks()

    def _complain(self, what: str) -> None:
        sentence = f"cell {self.cell!r} publishes {what}"
        if sentence not in self.complaints:
            self.complaints.append(sentence)

    def offers(self, skill: str) -> bool:
        """Whether somebody answers for a skill."""
        status: Any = self._queriers[skill].matching_status  # its stub says bool, it is a MatchingStatus
        return bool(status.matching)

    def ask(self, skill: str, request: Mapping[str, Any]) -> PendingAnswer:
        """Send a request to a skill; does not wait. Raises UnreachableError if there is no network to send it on."""
        payload = json.dumps(request, allow_nan=False)
        try:
            replies = self._queriers[skill].get(payload=payload, encoding="application/json")
        except zenoh.ZError as error:
            raise UnreachableError(f"cannot ask cell {self.cell!r} for skills/{skill}: {error}") from error
        return PendingAnswer(f"skills/{skill}", replies)


class PendingAnswer:
    """An answer under way."""

    def __init__(self, name: str, replies: Any) -> None:
        self._name, self._replies = name, replies
        self._answer: Answer | None = None

    def poll(self) -> Answer | None:
        """The answer if it is there; the first one counts. Does not wait."""
        if self._answer is None:
            self._answer = self._receive()
        return self._answer

    def _receive(self) -> Answer | None:
        try:
            reply = self._replies.try_recv()
        except zenoh.ZError:  # the query is over, and nobody has replied
            return Answer("silence", f"{self._name} gives no answer")
        if reply is None:
            return None
        if reply.ok is None:
            return _refusal(self._name, bytes(reply.err.payload))
        return _answer(self._name, bytes(reply.ok.payload))


def _answer(name: str, payload: bytes) -> Answer:
    try:
        document = json.loads(payload)
        status, reason = document["status"], document.get("reason")
    except (ValueError, KeyError, TypeError, AttributeError):
        return Answer("failure", f"{name} answers against the contract")
    if status == "success":
        return Answer("success", str(reason or ""))
    return Answer("failure", str(reason or "no reason given"))


def _refusal(name: str, payload: bytes) -> Answer:
    text = payload.decode(errors="replace")
    if text == "Timeout":  # Zenoh's own, when nobody has replied within the limit
        return Answer("silence", f"{name} gives no answer")
    try:
        return Answer("failure", str(json.loads(text)["error"]))
    except (ValueError, KeyError, TypeError):
        return Answer("failure", f"{name} refuses: {text[:200]}")


def _into(queue: deque[Arrival]) -> Any:
    def receive(sample: zenoh.Sample) -> None:
        queue.append((time.monotonic_ns(), bytes(sample.payload)))

    return receive


def _into_signals(queue: deque[tuple[str, Arrival]]) -> Any:
    def receive(sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).rpartition("/")[2]
        queue.append((name, (time.monotonic_ns(), bytes(sample.payload))))

    return receive
