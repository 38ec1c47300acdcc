"""What a tree asks beyond the conditions of the paper: signals, kinds, and what lies where (CONTRACT, vocabulary 2)."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

from learner.errors import ModelError
from learner.model.pose import Vector

ROUGH = "rough"


@dataclass(frozen=True, order=True)
class Site:
    """A place where something may lie: within `radius` [m] of `position` [m] in `frame`; `rough` in a cylinder."""

    frame: str
    position: Vector
    radius: float
    rough: bool = False

    def __str__(self) -> str:
        numbers = (repr(float(number)) for number in (*self.position, self.radius))
        return ";".join((self.frame, *numbers, *([ROUGH] if self.rough else [])))


def sites_of(text: str) -> tuple[Site, ...]:
    """The sites of a port `at` or `not_at`; none for an empty one. Raises ModelError for what is none."""
    return tuple(_site(part) for part in text.split("|")) if text else ()


def _site(text: str) -> Site:
    frame, *rest = text.split(";")
    rough = rest[4:] == [ROUGH]
    try:
        x, y, z, radius = (float(part) for part in (rest[:4] if rough else rest))
    except ValueError:
        raise ModelError(f"a place is frame;x;y;z;radius, with ;rough behind it or not; not {text!r}") from None
    if not frame or not all(map(math.isfinite, (x, y, z, radius))) or radius <= 0:
        raise ModelError(f"a place has a frame, finite numbers and a radius above 0; not {text!r}")
    return Site(frame, (x, y, z), radius, rough)


def written_sites(sites: tuple[Site, ...]) -> str:
    """The text of a port `at` or `not_at`."""
    return "|".join(map(str, sites))


def signal_of(text: str) -> bool | int | float | str:
    """The value of a signal that is written as JSON. Raises ModelError for anything but a bool, number or string."""
    try:
        value = json.loads(text, parse_constant=_refused)
    except ValueError as error:
        raise ModelError(f"the value of a signal is JSON, which {text!r} is not") from error
    if not isinstance(value, bool | int | float | str):
        raise ModelError(f"a signal is true, false, a number or a string, not {text!r}")
    return value


def _refused(constant: str) -> None:
    raise ValueError(f"{constant} is no number")


@dataclass(frozen=True, order=True)
class SignalIs:
    """A machine's `signal` has this `value`, which is JSON text."""

    signal: str
    value: str


@dataclass(frozen=True, order=True)
class SetSignal:
    """Set a machine's `signal` to this `value`, which is JSON text; done when the cell has set it."""

    signal: str
    value: str


@dataclass(frozen=True, order=True)
class CountAt:
    """At least `count` objects of a `kind`, not held, lie at the places `at`."""

    kind: str
    at: tuple[Site, ...]
    count: int


@dataclass(frozen=True, order=True)
class FindObject:
    """An object of a `kind` at one of the places `at` (none: anywhere) and at none of `not_at`."""

    kind: str
    at: tuple[Site, ...]
    not_at: tuple[Site, ...]


@dataclass(frozen=True, order=True)
class FindUpon:
    """The topmost of what lies upon an object."""

    object: str


@dataclass(frozen=True, order=True)
class FindUnder:
    """What an object lies upon, unless that is open or fixed."""

    object: str


@dataclass(frozen=True, order=True)
class FindInTheWay:
    """The topmost of what takes the room that an object needs to come down to `position` [m] in `frame`."""

    object: str
    frame: str
    position: Vector


@dataclass(frozen=True, order=True)
class FindHeld:
    """What is held."""


@dataclass(frozen=True, order=True)
class FindSpot:
    """The end-effector's pose in the base at which an object that is held comes down on a free spot."""

    object: str


@dataclass(frozen=True, order=True)
class FindGrasp:
    """The end-effector's pose in an object's frame at which to pick it, the next one after each that failed."""

    object: str


Query = FindObject | FindUpon | FindUnder | FindInTheWay | FindHeld | FindSpot | FindGrasp
"""What writes what it finds."""
