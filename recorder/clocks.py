"""Clocks that are set while something is recorded: the recorder's own, and those of the senders.

The recorder's log times come from a `LogClock` and never go back within a demonstration. What senders stamped is put
on one timeline when a recording is read (`straighten`; the rules are those of learner.model.stamps), so that matching
an action to poses by their stamps works in a file with steps and strays. The file itself keeps every stamp as it came.
"""

from __future__ import annotations

import heapq
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any, Final, Generic, NamedTuple, TypeVar

import numpy as np

from learner.model import ActionPress, GripperSample
from learner.model.stamps import AHEAD_NS, BACK_NS, NS, Step, Stray, Timeline
from recorder.wire import Sighting

NOTICED_NS: Final = NS // 2
"""A wall clock that is set by less [ns] is not worth a word."""
THE_GRIPPER: Final = "the gripper"

T = TypeVar("T")


class LogClock:
    """The time of the wall when it was last set by, and from then on that of a clock that never jumps."""

    def __init__(self) -> None:
        self.offset_ns = 0
        self._told_ns = 0
        self.set()

    def set(self) -> int:
        """Go by the wall clock as it is now; returns by how much [ns] this moves what was told before."""
        before, self.offset_ns = self.offset_ns, time.time_ns() - time.monotonic_ns()
        self._told_ns = 0
        return self.offset_ns - before

    def now_ns(self) -> int:
        """The time [ns] since the Unix epoch; never less than the last."""
        return self.offset_ns + time.monotonic_ns()

    def noticed(self) -> str | None:
        """A sentence if the wall clock has been set since the last look, else None."""
        away_ns = time.time_ns() - self.now_ns()
        jump_ns = away_ns - self._told_ns
        if abs(jump_ns) < NOTICED_NS:
            return None
        self._told_ns = away_ns
        return f"the recorder's own clock was set {_by(jump_ns)} while recording; its log times go on without that"


class Arrived(NamedTuple, Generic[T]):
    """Something that was stamped [ns], and when it was logged [ns]."""

    arrived_ns: int
    stamp_ns: int
    what: T


@dataclass(frozen=True)
class Straight:
    """What a recording holds, on one timeline, and in sentences what had to be moved or left out."""

    sightings: Mapping[str, Sequence[Sighting]]
    gripper: Sequence[GripperSample]
    presses: Sequence[ActionPress]
    notes: tuple[str, ...] = ()


def straighten(
    sightings: Mapping[str, Sequence[Arrived[Sighting]]],
    gripper: Sequence[Arrived[GripperSample]],
    presses: Sequence[Arrived[ActionPress]],
) -> Straight:
    """Put what was stamped by clocks that jump on one timeline; all in the order of the file.

    Where no stamp jumps, and that is nearly always, nothing is changed.
    """
    senders: dict[str, Sequence[Arrived[Sighting]] | Sequence[Arrived[GripperSample]]] = {
        **sightings,
        THE_GRIPPER: gripper,
    }
    if not any(map(_jumps, senders.values())):
        seen = {child: [each.what for each in found] for child, found in sightings.items()}
        return Straight(seen, [each.what for each in gripper], [each.what for each in presses])
    timeline: Timeline[tuple[str, Any]] = Timeline()
    kept = _follow(timeline, senders)
    return Straight(
        sightings={child: [what._replace(stamp_ns=stamp_ns) for stamp_ns, what in kept[child]] for child in sightings},
        gripper=[replace(what, stamp_ns=stamp_ns) for stamp_ns, what in kept[THE_GRIPPER]],
        presses=[replace(p.what, stamp_ns=timeline.moved(p.stamp_ns, p.arrived_ns)) for p in presses],
        notes=tuple(clock_sentences(timeline.steps, timeline.strays)),
    )


def _jumps(stamped: Sequence[Arrived[Any]]) -> bool:
    ahead = np.diff(np.array([each.stamp_ns for each in stamped], dtype=np.int64))
    return bool(np.any((ahead < -BACK_NS) | (ahead > AHEAD_NS)))


_Kept = dict[str, list[tuple[int, Any]]]
"""By sender what it said, each with its stamp [ns] on the timeline."""


def _follow(timeline: Timeline[tuple[str, Any]], senders: Mapping[str, Sequence[Arrived[Any]]]) -> _Kept:
    """What each sender said, without strays."""
    kept: _Kept = defaultdict(list)
    for sender, each in _in_order(senders):
        _keep(kept, timeline.take(sender, each.stamp_ns, each.arrived_ns, (sender, each.what)))
    _keep(kept, timeline.end())
    strays = {(stray.sender, stray.stamp_ns) for stray in timeline.strays}
    for sender, said in kept.items():
        said[:] = [each for each in said if (sender, each[1].stamp_ns) not in strays]
    return kept


def _keep(kept: _Kept, found: Iterable[tuple[int, tuple[str, Any]]]) -> None:
    for stamp_ns, (sender, what) in found:
        kept[sender].append((stamp_ns, what))


def _in_order(senders: Mapping[str, Sequence[Arrived[Any]]]) -> Iterator[tuple[str, Arrived[Any]]]:
    streams = [zip(repeat(sender), stamped) for sender, stamped in senders.items()]  # repeat has no end
    return heapq.merge(*streams, key=lambda named: named[1].arrived_ns)


def clock_sentences(steps: Sequence[Step], strays: Sequence[Stray]) -> Iterator[str]:
    """What to tell of clocks that jumped: a sentence for each step that senders took together, and for each stray."""
    together: dict[int, list[Step]] = defaultdict(list)
    for step in steps:
        together[step.shift_ns].append(step)
    for taken in together.values():
        who = ", ".join(dict.fromkeys(str(step.sender) for step in taken))
        yield f"the clock of {who} was set {_by(taken[0].jump_ns)} while recording; the account goes on"
    wrong: dict[object, list[Stray]] = defaultdict(list)
    for stray in strays:
        wrong[stray.sender].append(stray)
    for sender, found in wrong.items():
        off_ns = max((stray.off_ns for stray in found), key=abs)
        number = "one stamp" if len(found) == 1 else f"{len(found)} stamps"
        yield f"{number} of {sender} cannot be right, {_by(off_ns)}; what was so stamped is left out"


def _by(jump_ns: int) -> str:
    """Which way and by how much a clock jumped."""
    seconds = abs(jump_ns) / NS
    way = "ahead" if jump_ns > 0 else "back"
    for unit, length in (("days", 86400.0), ("hours", 3600.0)):
        if seconds >= 2 * length:
            return f"{way} by {seconds / length:.1f} {unit}"
    return f"{way} by {seconds:.1f} s"
