"""The presses of the demonstration that is under way, as the recorder has judged them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

MOST: Final = 200
"""So many presses are kept; nobody looks further back."""


@dataclass(frozen=True)
class Step:
    """One press with its verdict: 'accepted', 'doubtful' or 'contradicts' (CONTRACT, section 1: `recorder/press`)."""

    number: int
    type: str
    object: str | None
    stamp_ns: int
    verdict: str
    reason: str | None
    taken_back: bool = False


class Steps:
    """Presses in their order. One that is heard of twice, as the reply to who pressed and as an event, counts once."""

    def __init__(self) -> None:
        self.steps: tuple[Step, ...] = ()
        self._undone: set[int] = set()

    def clear(self) -> None:
        """Another demonstration begins."""
        self.steps = ()
        self._undone.clear()

    def take(self, document: Mapping[str, Any]) -> None:
        """Take in a reply to `recorder/press`, or an event `action`; what is not recorded is left out."""
        if document.get("recorded") is False or document.get("step") is None:
            return
        stamp_ns = int(document.get("action_stamp_ns") or document["stamp_ns"])
        if document["type"] == "undo":
            self._undo(stamp_ns, int(document["step"]))
            return
        step = Step(
            number=int(document["step"]),
            type=str(document["type"]),
            object=document.get("object"),
            stamp_ns=stamp_ns,
            verdict=str(document["verdict"]),
            reason=document.get("reason"),
        )
        self._put(step)

    def _put(self, step: Step) -> None:
        kept = [replace(step, taken_back=each.taken_back) if _same(each, step) else each for each in self.steps]
        if not any(_same(each, step) for each in self.steps):
            kept.append(step)
        self.steps = tuple(kept[-MOST:])

    def _undo(self, stamp_ns: int, number: int) -> None:
        if stamp_ns in self._undone:
            return
        self._undone.add(stamp_ns)
        standing = [place for place, each in enumerate(self.steps) if each.number == number and not each.taken_back]
        if standing:
            taken = replace(self.steps[standing[-1]], taken_back=True)
            self.steps = (*self.steps[: standing[-1]], taken, *self.steps[standing[-1] + 1 :])


def _same(one: Step, other: Step) -> bool:
    return (one.stamp_ns, one.type) == (other.stamp_ns, other.type)
