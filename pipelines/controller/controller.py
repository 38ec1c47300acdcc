"""A cell controller: a tree ticked against a cell's skills until its success lasts.

    Controller      the loop: take in what the cell published, tick, decide whether it is over
      Progress      what the nodes come to, for whoever looks on
      CellLeaves    what the tree acts on: conditions from learner.execution.perception, actions as skills of the cell
        CellLink    Zenoh

BehaviorTree.CPP's semantics start an action before the one that it replaces is halted. A cell has one arm, so a new
skill is asked for only when the old one has answered its cancellation; until then the new action is RUNNING.
"""

from __future__ import annotations

import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

from learner.execution.engine import Engine
from learner.execution.entries import Found
from learner.execution.perception import Checked, condition_of, query_of
from learner.execution.ticking import Status
from learner.model.action import Motion, SetGripper
from learner.model.condition import GripperState
from learner.model.query import Query
from learner.model.tree import Node, is_reference
from pipelines.controller.cell_link import Answer, CellLink, PendingAnswer
from pipelines.controller.progress import Moment, Progress
from pipelines.controller.trace import Trace
from pipelines.errors import UnreachableError

PERIOD_S: Final = 0.05
"""Time between two ticks [s]."""
POSES_LOST_S: Final = 1.0
"""Without a new pose of the end-effector for this long [s] the arm is stopped."""
SETTLE_S: Final = 1.0
"""Success is final when it has lasted this long [s]: what was just placed may still move (CONTRACT, section 3)."""
STUCK_S: Final = 3.0
"""A tree that fails for this long [s] without trying an action has nothing left to try."""
BUSY: Final = "busy"
"""The reason of a cell that cannot do a skill because it does another begins so."""
BUSY_LIMIT_S: Final = 60.0
"""What another controller began, which may have died since, is waited for so long [s]."""
NEVER_HELD: Final = 3
"""So many times a Pick may succeed without that its object is seen to be held; then it never will be."""
FAILURES_IN_A_ROW: Final = 10
"""So many failed motions without one that succeeds end the run: the cell cannot do what the tree asks for."""
RETRY_S: Final = 0.3
"""After a failed action the next one waits this long [s]: what fails at once is not asked for at every tick."""
SEEN_AFTER_S: Final = 0.5
"""An action ends for the tree when the cell was seen after it, at the latest after this long [s]."""
CANCEL_AGAIN_S: Final = 0.2
"""A cancellation is repeated this often [s]: the first may have overtaken the request that it is for."""
CANCEL_LIMIT_S: Final = 3.0
"""A skill that does not answer its cancellation for this long [s] is out of control."""
SKILL_LIMIT_S: Final = 300.0
"""A skill that takes longer [s] is cancelled, and the run ends."""

TOLD: Final = ("count", "kind", "object", "signal", "state", "value")
"""The ports that tell leaves of one kind apart to a reader, but for the frame."""

Outcome = Literal["success", "failure", "timeout", "stopped", "lost"]


@dataclass(frozen=True)
class RunResult:
    """How a run ended, with a sentence that says why, and what it took; `actions` counts those that were started."""

    outcome: Outcome
    reason: str
    ticks: int
    actions: int


def described(node: Node) -> str:
    """A leaf in few words: `Pick A in box`."""
    told = [node.kind, *(str(value) for name, value in node.ports if name in TOLD and not is_reference(value))]
    frame = dict(node.ports).get("frame")
    return " ".join(told) + (f" in {frame}" if frame is not None else "")


class Execution:
    """One start of an action: asked for when the arm is free, over when the cell was seen after its answer."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.execution_id = uuid.uuid4().hex
        self.pending: PendingAnswer | None = None
        self.answer: Answer | None = None
        self.asked_s = self.answered_s = self.cancelled_s = 0.0
        self.cancel_sent_s = float("-inf")

    @property
    def request(self) -> dict[str, Any]:
        """The node's ports as JSON (CONTRACT, section 1)."""
        ports = {name: list(value) if isinstance(value, tuple) else value for name, value in self.node.ports}
        return {**ports, "execution_id": self.execution_id}

    @property
    def gripper_expected(self) -> GripperState | None:
        """What the gripper must say once the action has succeeded."""
        word = self.node.word
        if isinstance(word, SetGripper):
            return word.state
        return {"Pick": "closed", "Place": "open", "Drop": "open"}.get(self.node.kind)  # type: ignore[return-value]  # both are states


class CellLeaves:
    """The leaves of a tree on a real cell (learner.execution.ticking.Leaves).

    GripperIs and InGripper keep their values from the moment a skill is asked for until its action has ended or is
    halted. Raises UnreachableError when the cell stops answering: what the arm does is then not known.
    """

    def __init__(self, link: CellLink, trace: Trace) -> None:
        self._link, self._state, self._trace = link, link.state, trace
        self._held_before: dict[Checked, bool] = {}
        self._found_before: dict[Query, Found | None] = {}
        self._active: dict[int, Execution] = {}
        self._moving: Execution | None = None
        self._cancellation: PendingAnswer | None = None
        """The last cancellation: its reply is not waited for, but Zenoh complains if nobody is there to take it."""
        self._failed_s = float("-inf")
        self.actions = 0
        self.failures_in_a_row = 0
        self.failures: Counter[str] = Counter()
        """How often each action failed."""
        self.last_failure = ""
        self.busy_since_s: float | None = None
        """Since when the cell has refused every skill because it does another."""
        self.never_held: dict[str, int] = {}
        """How often in a row a Pick of each object succeeded although the object was not seen to be held."""
        self.touched = False
        """Whether an action was begun, under way or ended since this was last set to False."""

    @property
    def idle(self) -> bool:
        """Whether no skill is under way in the cell and none is waiting."""
        return self._moving is None and not self._active

    @property
    def action(self) -> str | None:
        """The action that is under way or waits for the arm, in few words."""
        return next((described(execution.node) for execution in self._active.values()), None)

    def check(self, node: Node) -> bool:
        condition = condition_of(node)
        holds = self._state.holds(condition)
        if self._held_before.get(condition) is not holds:
            self._held_before[condition] = holds
            self._trace.write("condition", node=node.kind, ports=dict(node.ports), holds=holds)
        return holds

    def find(self, node: Node) -> Found | None:
        query = query_of(node)
        found = self._state.find(query)
        if query not in self._found_before or self._found_before[query] != found:
            self._found_before[query] = found
            self._trace.write("query", node=node.kind, ports=dict(node.ports), found=found)
        return found

    def tick_action(self, node: Node) -> Status:
        self.touched = True
        execution = self._active.get(id(node)) or self._active.setdefault(id(node), Execution(node))
        if execution.pending is None and self._moving is None and time.monotonic() - self._failed_s > RETRY_S:
            self._ask(execution)
        if execution.answer is None or not self._seen_after(execution):
            return Status.RUNNING
        if execution.answer.status == "failure" and execution.answer.reason.startswith(BUSY):
            return self._put_off(node)
        self.busy_since_s = None
        del self._active[id(node)]
        self._moving = None
        return self._end(execution, execution.answer)

    def _put_off(self, node: Node) -> Status:
        """The cell still does what another controller asked for, which may be gone: ask again in a moment."""
        self._state.thaw_gripper()
        self._active[id(node)], self._moving = Execution(node), None
        self._failed_s = time.monotonic()
        self.busy_since_s = self.busy_since_s or self._failed_s
        return Status.RUNNING

    def halt_action(self, node: Node) -> None:
        execution = self._active.pop(id(node))
        if execution.pending is None:
            return
        self._state.thaw_gripper()
        if execution.answer is None:
            execution.cancelled_s = time.monotonic()
            self._cancel(execution)
        else:
            self._moving = None
        self._trace.write("halt", action=described(node), execution_id=execution.execution_id)

    def poll(self) -> None:
        """Look for the answer of the skill that is under way; once a tick, before it."""
        execution = self._moving
        if execution is None or execution.pending is None or execution.answer is not None:
            return
        execution.answer = execution.pending.poll()
        if execution.answer is None:
            self._wait_on(execution)
        else:
            self._answered(execution, execution.answer)

    def stop(self) -> None:
        """Cancel what is under way and wait until the cell has confirmed it. Raises UnreachableError if it does not."""
        for execution in list(self._active.values()):
            self.halt_action(execution.node)
        while self._moving is not None:
            time.sleep(PERIOD_S / 5)
            self.poll()

    def _ask(self, execution: Execution) -> None:
        self._state.freeze_gripper()
        execution.pending = self._link.ask(execution.node.kind, execution.request)
        execution.asked_s = time.monotonic()
        self._moving = execution
        self.actions += 1
        poses = {name: [*pose.position, *pose.quaternion_xyzw] for name, pose in self._state.poses().items()}
        self._trace.write(
            "start", action=described(execution.node), request=execution.request, held=self._state.held, poses=poses
        )

    def _answered(self, execution: Execution, answer: Answer) -> None:
        execution.answered_s = time.monotonic()
        self._trace.write("answer", execution_id=execution.execution_id, status=answer.status, reason=answer.reason)
        if execution.cancelled_s:
            self._moving = None
        elif answer.status == "silence":
            self._cancel(execution)
            raise UnreachableError(f"cell {self._link.cell!r} {answer.reason} to {described(execution.node)}")

    def _wait_on(self, execution: Execution) -> None:
        now_s = time.monotonic()
        what = f"cell {self._link.cell!r} does not answer"
        if not execution.cancelled_s:
            if now_s - execution.asked_s > SKILL_LIMIT_S:
                raise UnreachableError(f"{what} {described(execution.node)} within {SKILL_LIMIT_S:.0f} s")
        elif now_s - execution.cancelled_s > CANCEL_LIMIT_S:
            self._moving = None
            raise UnreachableError(f"{what} the cancellation of {described(execution.node)}; look at the arm")
        elif now_s - execution.cancel_sent_s > CANCEL_AGAIN_S:
            self._cancel(execution)

    def _cancel(self, execution: Execution) -> None:
        execution.cancel_sent_s = time.monotonic()
        self._cancellation = self._link.ask("cancel", {"execution_id": execution.execution_id})

    def _seen_after(self, execution: Execution) -> bool:
        now_s, hand_s = time.monotonic(), self._link.hand_received_s
        hand_seen = hand_s is not None and hand_s > execution.answered_s
        expected = execution.gripper_expected if execution.answer and execution.answer.status == "success" else None
        gripper_seen = expected is None or self._state.gripper == expected
        return (hand_seen and gripper_seen) or now_s - execution.answered_s > SEEN_AFTER_S

    def _end(self, execution: Execution, answer: Answer) -> Status:
        succeeded = answer.status == "success"
        word = execution.node.word
        if not succeeded and isinstance(word, Motion) and word.type == "Pick" and word.frame == word.object:
            self._state.pick_failed(word.object, word.pose)
        self._state.thaw_gripper()
        if succeeded and isinstance(word, Motion) and word.type == "Pick":
            seen = self._state.held == word.object
            self.never_held[word.object] = 0 if seen else self.never_held.get(word.object, 0) + 1
        if succeeded and execution.node.kind != "SetGripper":
            self.failures_in_a_row = 0
        elif not succeeded:
            self.failures_in_a_row += 1
            self.failures[described(execution.node)] += 1
            self._failed_s = time.monotonic()
            self.last_failure = f"{described(execution.node)}: {answer.reason}"
        self._trace.write(
            "end", action=described(execution.node), execution_id=execution.execution_id, status=answer.status
        )
        return Status.SUCCESS if succeeded else Status.FAILURE


class Controller:
    """One run of a flattened tree on a cell. The link must be open and the cell complete.

    While watching, `tell` hears `{"event": "success"}` when the goal has been reached, and `{"event": "disturbed"}`
    when it holds no more. `progress` tells whoever looks on what the nodes come to.
    """

    def __init__(
        self,
        root: Node,
        link: CellLink,
        trace: Trace,
        tell: Callable[[dict[str, Any]], None] | None = None,
        progress: Progress | None = None,
    ) -> None:
        self._link, self._trace, self._tell, self._progress = link, trace, tell, progress
        self._leaves = CellLeaves(link, trace)
        self._engine = Engine(root, self._leaves)
        self._status: Status | None = None
        self._good_since_s: float | None = None
        self._stuck_since_s: float | None = None
        self._reached = False

    def run(self, stop: threading.Event, timeout_s: float | None = None, watch: bool = False) -> RunResult:
        """Tick until success has lasted, the tree has nothing left to try, the time is over, or `stop` is set.

        With `watch` success does not end it: the tree is ticked on, so that what is disturbed later is repaired, and
        the outcome is 'success' if the goal holds when the time is over or `stop` is set. Whatever happens, a skill
        under way is cancelled first. Outcome 'lost': the poses stopped, or the cell does not answer.
        """
        started_s = time.monotonic()
        self._link.state.begin()
        try:
            ended = self._loop(stop, started_s, timeout_s, watch)
        except UnreachableError as error:
            ended = "lost", str(error)
        finally:
            still_moving = self._stop()
        outcome, reason = ended if still_moving is None else ("lost", f"{ended[1]}; {still_moving}")
        if self._progress:
            self._progress.end(outcome, reason, self._engine.statuses())
        self._trace.write("outcome", outcome=outcome, reason=reason)
        return RunResult(outcome, reason, self._trace.tick, self._leaves.actions)

    def _loop(
        self, stop: threading.Event, started_s: float, timeout_s: float | None, watch: bool
    ) -> tuple[Outcome, str]:
        next_s = started_s
        while not stop.wait(max(0.0, next_s - time.monotonic())):
            now_s = time.monotonic()
            next_s = max(next_s + PERIOD_S, now_s)
            self._tick(now_s)
            ended = self._ended(now_s, watch)
            if ended:
                return ended
            if timeout_s is not None and now_s - started_s >= timeout_s:
                return self._left("timeout", f"the goal does not hold after {timeout_s:g} s", watch)
        return self._left("stopped", "stopped from outside", watch)

    def _tick(self, now_s: float) -> None:
        self._trace.tick += 1
        self._link.take_in()
        hand_s = self._link.hand_received_s
        if hand_s is None or now_s - hand_s > POSES_LOST_S:
            hand = self._link.state.end_effector_frame
            raise UnreachableError(f"cell {self._link.cell!r}: no new pose of {hand!r} for {POSES_LOST_S:g} s")
        self._leaves.poll()
        self._leaves.touched = False
        status = self._engine.tick()
        if status is not self._status:
            self._trace.write("status", status=status.value)
        self._status = status
        if self._progress and self._progress.due:
            self._tell_progress(self._progress)

    def _tell_progress(self, progress: Progress) -> None:
        leaves, began_s = self._leaves, time.monotonic()
        moment = Moment(
            tick=self._trace.tick,
            status=self._status and self._status.value,
            action=leaves.action,
            failures=dict(leaves.failures),
            reason=leaves.last_failure or None,
        )
        progress.tell(moment, self._engine.statuses(), began_s)

    def _ended(self, now_s: float, watch: bool) -> tuple[Outcome, str] | None:
        leaves = self._leaves
        if leaves.failures_in_a_row >= FAILURES_IN_A_ROW:
            return "failure", f"{leaves.failures_in_a_row} actions failed in a row, the last was {leaves.last_failure}"
        if leaves.busy_since_s is not None and now_s - leaves.busy_since_s > BUSY_LIMIT_S:
            return "failure", f"the cell does something else since {BUSY_LIMIT_S:g} s: a skill that nobody here began"
        unbelieved = [name for name, times in leaves.never_held.items() if times >= NEVER_HELD]
        if unbelieved:
            return "failure", (
                f"Pick {unbelieved[0]} succeeded {NEVER_HELD} times, but InGripper {unbelieved[0]} did not hold after "
                "it: the object was not seen within 5 cm of the closed gripper, or did not move with it"
            )
        quiet = leaves.idle and not leaves.touched
        self._good_since_s = self._since(self._good_since_s, quiet and self._status is Status.SUCCESS, now_s)
        self._stuck_since_s = self._since(self._stuck_since_s, quiet and self._status is Status.FAILURE, now_s)
        if watch:
            self._tell_of_goal(self._goal_holds(now_s))
        elif self._goal_holds(now_s):
            return "success", f"the tree has succeeded for {SETTLE_S:g} s"
        if self._stuck_since_s is not None and now_s - self._stuck_since_s >= STUCK_S and not watch:
            return "failure", f"the tree has failed for {STUCK_S:g} s and has no action left to try{self._hidden()}"
        return None

    @staticmethod
    def _since(since_s: float | None, lasts: bool, now_s: float) -> float | None:
        return (now_s if since_s is None else since_s) if lasts else None

    def _goal_holds(self, now_s: float) -> bool:
        return self._good_since_s is not None and now_s - self._good_since_s >= SETTLE_S

    def _tell_of_goal(self, holds: bool) -> None:
        if holds is self._reached or (not holds and self._status is Status.SUCCESS):
            return
        self._reached = holds
        event = "success" if holds else "disturbed"
        self._trace.write(event)
        if self._tell:
            self._tell({"event": event, "tick": self._trace.tick})

    def _left(self, outcome: Outcome, reason: str, watch: bool) -> tuple[Outcome, str]:
        if watch and self._goal_holds(time.monotonic()):
            return "success", "the goal held when the watch ended"
        return outcome, reason

    def _hidden(self) -> str:
        state = self._link.state
        hidden = [name for name in state.poses() if state.unseen(name)]
        return f"; unseen for 10 s: {', '.join(hidden)}" if hidden else ""

    def _stop(self) -> str | None:
        """Stop the arm; a sentence if the cell has not confirmed it."""
        try:
            self._leaves.stop()
        except UnreachableError as error:
            return str(error)
        return None
