"""Requests to the recorder, checked where they enter: what the contract's section 1 admits, and nothing else."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, get_args

from learner.errors import NameRefusedError
from learner.model import ActionPress, check_name
from learner.model.demonstration import ActionType, Outcome
from learner.observation.presses import SIGNAL, TYPES, UNDO
from recorder.errors import PayloadError, RequestRefusedError
from recorder.recording import Demonstrated, parse_scene
from recorder.wire import action_message, parse_action

VERBS: Final = ("start", "stop", "discard", "pause", "resume", "split", "press", "status")
_NEEDED: Final = ("task", "user", "objects", "base_frame", "end_effector_frame")


def parse_request(verb: str, payload: bytes) -> dict[str, Any]:
    """The JSON object of a request; nothing at all stands for `{}`. Raises RequestRefusedError."""
    if verb not in VERBS:
        raise RequestRefusedError(f"the recorder knows {', '.join(VERBS)}, not {verb[:80]!r}")
    try:
        request = json.loads(payload or b"{}")
    except (ValueError, RecursionError) as error:
        raise RequestRefusedError(f"the request {verb} is not JSON: {error}") from error
    if not isinstance(request, dict):
        raise RequestRefusedError(f"the request {verb} is a JSON object, not {str(request)[:80]}")
    return request


@dataclass(frozen=True)
class Start:
    """A checked request to start: every name is one of the contract's."""

    task: str
    user: str
    objects: tuple[str, ...]
    base_frame: str
    end_effector_frame: str
    scene: str | None
    unseen_ok: bool = False
    """Whether names that the cell's poses do not tell of are taken all the same."""

    @property
    def wanted(self) -> dict[str, str]:
        """What the cell's poses have to tell of, and what each name is."""
        shapes = parse_scene(self.scene).objects if self.scene else {}
        of_scene = dict.fromkeys(shapes, "object of the scene")
        return {**of_scene, **dict.fromkeys(self.objects, "object"), self.end_effector_frame: "frame"}

    def demonstrated(self, demonstration_id: str, cell: str, start_ns: int) -> Demonstrated:
        """What the recording that begins will say of itself."""
        return Demonstrated(
            demonstration_id=demonstration_id,
            task=self.task,
            user=self.user,
            cell=cell,
            base_frame=self.base_frame,
            end_effector_frame=self.end_effector_frame,
            objects=self.objects,
            start_ns=start_ns,
            scene=self.scene,
        )

    @staticmethod
    def parse(request: Mapping[str, Any]) -> Start:
        """Raises RequestRefusedError with what is missing or wrong."""
        unseen_ok = request.get("unseen_ok", False)
        if not isinstance(unseen_ok, bool):
            raise RequestRefusedError(f"`unseen_ok` of the request start is true or false, not {unseen_ok!r:.80}")
        missing = [name for name in _NEEDED if request.get(name) is None]
        if missing:
            raise RequestRefusedError(f"the request start lacks {', '.join(missing)}")
        try:
            return Start(
                task=check_name("task", request["task"]),
                user=check_name("user", request["user"]),
                objects=_objects(request),
                base_frame=check_name("frame", request["base_frame"]),
                end_effector_frame=check_name("frame", request["end_effector_frame"]),
                scene=_scene(request.get("scene")),
                unseen_ok=unseen_ok,
            )
        except NameRefusedError as error:
            raise RequestRefusedError(str(error)) from error


def _objects(request: Mapping[str, Any]) -> tuple[str, ...]:
    objects = request["objects"]
    if not isinstance(objects, list) or not objects:
        raise RequestRefusedError("`objects` of the request start is a list of at least one name")
    names = tuple(check_name("object", name) for name in objects)
    frames = [request["base_frame"], request["end_effector_frame"]]
    if len({*names, *map(str, frames)}) < len(names) + len(frames):
        raise RequestRefusedError("objects, base frame and end-effector frame need names of their own")
    return names


def _scene(scene: Any) -> str | None:
    if scene is None:
        return None
    text = scene if isinstance(scene, str) else json.dumps(scene, sort_keys=True)
    try:
        parse_scene(text)
    except ValueError as error:
        raise RequestRefusedError(str(error)) from error
    return text


def parse_outcome(request: Mapping[str, Any]) -> str:
    """The outcome of a request to stop. Raises RequestRefusedError."""
    outcome = request.get("outcome")
    if outcome not in get_args(Outcome):
        raise RequestRefusedError(f"the outcome of a stop is {', '.join(get_args(Outcome))}, not {outcome!r:.80}")
    return str(outcome)


_FITTING: Final = {
    **dict.fromkeys(get_args(ActionType), frozenset({"object"})),
    SIGNAL: frozenset({"signal", "value"}),
    UNDO: frozenset[str](),
}
"""Which fields a press of each type may have, beside its type and stamp."""


def parse_press(request: Mapping[str, Any], now_ns: int) -> ActionPress:
    """The action that a request to press names; without `stamp_ns` it is of now [ns]. Raises RequestRefusedError."""
    kind, stamp_ns = str(request.get("type")), request.get("stamp_ns", now_ns)
    if kind not in TYPES:
        raise RequestRefusedError(f"a press is of type {', '.join(TYPES)}, not {kind!r:.80}")
    given = {name: value for name, value in request.items() if value is not None and name not in ("type", "stamp_ns")}
    strange = sorted(given.keys() - _FITTING[kind])
    if strange:
        raise RequestRefusedError(f"a press of type {kind} has no {', '.join(strange)!s:.80}")
    if kind == SIGNAL and given.keys() != _FITTING[SIGNAL]:
        raise RequestRefusedError("a press of type signal needs signal and value")
    try:
        for name in given.keys() & {"object", "signal"}:
            check_name(name, given[name])
        return parse_action(action_message(stamp_ns, kind, **given))
    except NameRefusedError as error:
        raise RequestRefusedError(str(error)) from error
    except PayloadError as error:
        raise RequestRefusedError(f"the press {kind} {error}") from error
