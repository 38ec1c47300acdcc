"""The fields of a request to the simulated cell, checked where they enter."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, get_args

import zenoh

from learner.model import Pose
from learner.model.condition import GripperState
from pipelines.errors import CommandError

Fields = Mapping[str, Any]


class BadRequestError(CommandError):
    """A request that is not as the contract says: answered by an error reply."""


def fields_of(query: zenoh.Query) -> Fields:
    """The JSON object of a request; nothing at all stands for `{}`. Raises BadRequestError, as all that follow."""
    payload = query.payload.to_bytes() if query.payload is not None else b""
    try:
        return object_in(json.loads(payload or b"{}"))
    except ValueError as error:
        raise BadRequestError(f"the request is not JSON: {error}") from error


def object_in(value: Any) -> Fields:
    """The value, if it is a JSON object."""
    if not isinstance(value, dict):
        raise BadRequestError("the request is not a JSON object")
    return value


def text_in(fields: Fields, name: str) -> str:
    """A text of at least one character."""
    value = fields.get(name)
    if not isinstance(value, str) or not value:
        raise BadRequestError(f"{name} is missing: it is a text")
    return value


def state_in(fields: Fields) -> GripperState:
    """The state of a gripper."""
    states: tuple[GripperState, ...] = get_args(GripperState)
    state = fields.get("state")
    if state not in states:
        raise BadRequestError(f"state is open or closed, not {state!r}")
    return states[states.index(state)]


def pose_in(fields: Fields) -> Pose:
    """The pose of the fields position [m] and orientation (xyzw)."""
    return Pose.of(_numbers(fields, "position", 3), _numbers(fields, "orientation", 4))


def _numbers(fields: Fields, name: str, length: int) -> list[float]:
    values = fields.get(name)
    whole = isinstance(values, list | tuple) and len(values) == length
    if not whole or not all(_is_finite(value) for value in values or ()):
        raise BadRequestError(f"{name} is an array of {length} finite numbers")
    return [float(value) for value in values or ()]


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def share_in(fields: Fields, name: str) -> float:
    """A share of all."""
    value = fields[name]
    if not _is_finite(value) or not 0.0 <= value <= 1.0:
        raise BadRequestError(f"{name} is a number from 0 to 1")
    return float(value)
