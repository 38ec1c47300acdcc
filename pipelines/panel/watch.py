"""What a cell publishes and what its recorder says, as pages show it: taken in once, whoever looks."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

from learner.model import Pose
from learner.model.scene import Scene
from pipelines.errors import CommandError
from pipelines.network.question import ask
from pipelines.panel.steps import Step, Steps
from recorder import wire
from recorder.errors import PayloadError

if TYPE_CHECKING:
    import zenoh

STATUS_S: Final = 0.4
"""Time between two questions for the recorder's status [s]."""
PATIENCE_S: Final = 2.0
"""A recorder that has not answered for this long [s] is shown as silent."""
BUTTON_S: Final = 60.0
"""Patience with an answer to a button: a stop waits for the disk [s]."""
MOST_NAMES: Final = 200
"""So many names are shown of those that are published; a cell has fewer."""


@dataclass(frozen=True)
class Frames:
    """The base frame in which a cell's poses are, and the child that is its hand."""

    base: str = "base"
    hand: str = "tool0"


@dataclass(frozen=True)
class Sight:
    """What was known of the cell at one moment; ages in [s] since something new came.

    `poses` are in the base frame. `status` is the recorder's reply, None while it does not answer, for which
    `silence` is the reason. `oddity` is what was published against the contract last.
    """

    poses: Mapping[str, Pose] = field(default_factory=dict)
    ages_s: Mapping[str, float] = field(default_factory=dict)
    gripper: str | None = None
    gripper_age_s: float | None = None
    status: Mapping[str, Any] | None = None
    silence: str = ""
    steps: tuple[Step, ...] = ()
    scene: Scene | None = None
    oddity: str = ""

    def objects(self, frames: Frames) -> tuple[str, ...]:
        """The names of what can be taken: everything that has a pose, without the hand."""
        return tuple(sorted(name for name in self.poses if name != frames.hand))


class CellWatch:
    """Hears a cell from entering to leaving its context. `now` is what is known; `press` and `button` ask its recorder.

    `scene` are the shapes on the table; without them a simulated cell is asked for its own.
    """

    def __init__(self, session: zenoh.Session, cell: str, frames: Frames, scene: Scene | None = None) -> None:
        self.cell, self.frames = cell, frames
        self._session, self._scene = session, scene
        self._lock = threading.Lock()
        self._seen: dict[str, tuple[int, Pose, float]] = {}
        self._gripper: tuple[str, float] | None = None
        self._status: Mapping[str, Any] | None = None
        self._silence = self._oddity = ""
        self._steps = Steps()
        self._stopping = threading.Event()
        self._open = ExitStack()
        self._thread = threading.Thread(target=self._poll, name=f"panel-{cell}", daemon=True)

    def __enter__(self) -> Self:
        heard = {"poses": self._take_poses, "gripper": self._take_gripper, "recorder/events": self._take_event}
        for topic, take in heard.items():
            key = wire.key_of(self.cell, topic)
            self._open.enter_context(self._session.declare_subscriber(key, self._guarded(take)))
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._thread.join()
        self._open.close()

    def now(self) -> Sight:
        """What is known at this moment."""
        with self._lock:
            now_s = time.monotonic()
            return Sight(
                poses={name: pose for name, (_, pose, _) in sorted(self._seen.items())},
                ages_s={name: now_s - since_s for name, (_, _, since_s) in self._seen.items()},
                gripper=self._gripper and self._gripper[0],
                gripper_age_s=self._gripper and now_s - self._gripper[1],
                status=self._status,
                silence=self._silence,
                steps=self._steps.steps,
                scene=self._scene,
                oddity=self._oddity,
            )

    def press(self, kind: str, name: str | None) -> dict[str, Any]:
        """Press an action; the recorder's verdict. Raises CommandError with its sentence if it takes none."""
        reply = self._ask("press", {"type": kind, **({"object": name} if name else {})})
        with self._lock:
            self._steps.take(reply)
        return reply

    def button(self, verb: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        """The recorder's reply to a request. Raises CommandError with its sentence if it refuses or is not there."""
        reply = self._ask(verb, fields)
        self._look()
        return reply

    def _ask(self, verb: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        patience_s = BUTTON_S if self._status else PATIENCE_S
        return ask(self._session, wire.key_of(self.cell, f"recorder/{verb}"), fields, patience_s)

    def _poll(self) -> None:
        while not self._stopping.wait(STATUS_S):
            self._look()
            if self._scene is None:
                self._ask_scene()

    def _look(self) -> None:
        try:
            status, silence = ask(self._session, wire.key_of(self.cell, "recorder/status"), {}, PATIENCE_S), ""
        except CommandError as error:
            status, silence = None, str(error)
        with self._lock:
            self._status, self._silence = status, silence

    def _ask_scene(self) -> None:
        """A simulated cell tells its shapes; a real one has no answer to that, and needs none."""
        key = wire.key_of(self.cell, "sim/scene")
        for reply in self._session.get(key, timeout=PATIENCE_S):
            if reply.ok is not None:
                self._take(self._take_scene, key, reply.ok.payload.to_bytes())

    def _guarded(self, take: Callable[[bytes], None]) -> Callable[[zenoh.Sample], None]:
        return lambda sample: self._take(take, str(sample.key_expr), bytes(sample.payload))

    def _take(self, take: Callable[[bytes], None], key: str, payload: bytes) -> None:
        """Take in a message; what is published against the contract is shown, and hides nothing else."""
        with self._lock:
            try:
                take(payload)
            except PayloadError as error:
                self._oddity = f"a message on {key} {error}"
            except (ValueError, KeyError, TypeError) as error:
                self._oddity = f"a message on {key} is not as the contract says: {type(error).__name__}: {error}"

    def _take_poses(self, payload: bytes) -> None:
        for transform in wire.parse_transforms(payload):
            seen = wire.parse_sighting(transform)
            before_ns = self._seen[seen.child][0] if seen.child in self._seen else -1
            known = seen.child in self._seen or len(self._seen) < MOST_NAMES
            if seen.parent == self.frames.base and seen.stamp_ns != before_ns and known:
                pose = Pose(seen.position, seen.quaternion_xyzw)
                self._seen[seen.child] = seen.stamp_ns, pose, time.monotonic()

    def _take_gripper(self, payload: bytes) -> None:
        self._gripper = wire.parse_gripper(payload).state, time.monotonic()

    def _take_scene(self, payload: bytes) -> None:
        self._scene = Scene.of_data(json.loads(payload)["scene"])

    def _take_event(self, payload: bytes) -> None:
        event = json.loads(payload)
        if event["event"] == "start":
            self._steps.clear()
        elif event["event"] == "action":
            self._steps.take(event)
