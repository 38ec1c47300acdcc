"""Requests to the recorder, checked where they enter: what the contract's section 1 admits, and nothing else."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, get_args

from learner.errors import NameRefusedError
from learner.model import check_name
from learner.model.demonstration import Outcome
from recorder.errors import RequestRefusedError
from recorder.recording import parse_scene

VERBS: Final = ("start", "stop", "discard", "pause", "resume", "split", "status")
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

    @staticmethod
    def parse(request: Mapping[str, Any]) -> Start:
        """Raises RequestRefusedError with what is missing or wrong."""
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
