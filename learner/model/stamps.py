"""Stamps that jump: one timeline for a cell whose senders' clocks are set, restarted, or wrong for a moment.

Freshness compares stamps with stamps, so a clock that is set back an hour would hide every later pose behind the
earlier ones, and one stamp in the far future would make every other pose old. A `Timeline` follows each sender (a
child of /poses, the gripper) in order of arrival and decides what a jump is:

late     behind, but within a minute and sooner over than it took: out of a publisher's cache. It stays where it is.
stray    the sender goes on where it was: the stamp was wrong once. It is left out.
step     the sender goes on from there: its clock was set, or it was started again. From then on its stamps are moved
         so that time goes on; all senders of a cell that took the same step are moved by the same.

What cannot be decided yet waits for the sender's next stamps. Nothing here reads a clock: arrival times are handed in,
from any clock that does not jump. A file whose arrival times are not of that kind, or a replay at many times the
speed, is left as it is: jumps in it are not called steps.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Final, Generic, NamedTuple, TypeVar

NS: Final = 1_000_000_000
BACK_NS: Final = NS // 2
"""Samples may overtake each other by so much [ns]."""
AHEAD_NS: Final = 5 * NS
"""A sender that was silent may jump ahead by so much more [ns] than the time that passed, three times over."""
LATE_NS: Final = 60 * NS
"""A publisher's cache reaches back no further [ns]; what is further back is no late sample."""
CONFIRMED: Final = 3
"""So many stamps in a row make a jump a step, ..."""
LIVE_NS: Final = NS // 5
"""... that have taken so long to arrive [ns], ..."""
LIVE_RATE: Final = 3
"""... and were not stamped at more than so many times the speed at which they arrived."""
SAME_NS: Final = 2 * NS
"""Steps that bring two senders so near to each other [ns] are one."""

Item = TypeVar("Item")


class Stamped(NamedTuple, Generic[Item]):
    """Something that a sender stamped [ns] and that arrived [ns]."""

    stamp_ns: int
    arrived_ns: int
    item: Item


@dataclass(frozen=True)
class Step:
    """From an arrival [ns] on a sender's stamps are moved by `shift_ns`; `jump_ns` is by how much its clock went on."""

    sender: Hashable
    arrived_ns: int
    shift_ns: int
    jump_ns: int


@dataclass(frozen=True)
class Stray:
    """One wrong stamp [ns] of a sender, off by `off_ns` from where it was."""

    sender: Hashable
    arrived_ns: int
    stamp_ns: int
    off_ns: int


@dataclass
class _Sender(Generic[Item]):
    """The last ordinary stamp of a sender, what its stamps are moved by, and what is not decided yet."""

    stamp_ns: int
    arrived_ns: int
    shift_ns: int = 0
    known_since_ns: int = 0
    """The arrival [ns] of its first stamp."""
    alone: bool = True
    """Whether nothing has followed its first stamp yet, which may be the stray one."""
    waiting: list[Stamped[Item]] = field(default_factory=list)

    def goes_on(self, stamp_ns: int, arrived_ns: int) -> bool:
        """Whether a stamp follows the last ordinary one, or overtook it by a little."""
        ahead = stamp_ns - self.stamp_ns
        return -BACK_NS <= ahead <= AHEAD_NS + LIVE_RATE * max(arrived_ns - self.arrived_ns, 0)

    def waits_for(self, stamp_ns: int, arrived_ns: int) -> bool:
        """Whether a stamp follows those that wait."""
        last = self.waiting[-1]
        return _Sender[Item](last.stamp_ns, last.arrived_ns).goes_on(stamp_ns, arrived_ns)


class Timeline(Generic[Item]):
    """The common timeline of a cell's senders. Not safe for threads.

    `take` returns what is decided: items with their stamps on the timeline, in the order of their arrival. `steps` and
    `strays` tell what was found; whoever tells a person may take them out. A sender's first item is returned at once,
    and may turn out a stray: whoever keeps items forgets it then.
    """

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.strays: list[Stray] = []
        self._senders: dict[Hashable, _Sender[Item]] = {}
        self._shifts = [0]
        self._now_ns, self._now_arrived_ns = 0, 0

    @property
    def jumped(self) -> bool:
        """Whether any sender's clock has taken a step."""
        return len(self._shifts) > 1

    def take(self, sender: Hashable, stamp_ns: int, arrived_ns: int, item: Item) -> list[tuple[int, Item]]:
        """Take the next stamp of a sender as it arrives; both in [ns]."""
        known = self._senders.get(sender)
        if known is None:
            shift_ns = self._shift_near(stamp_ns, arrived_ns)
            self._senders[sender] = _Sender(stamp_ns, arrived_ns, shift_ns, arrived_ns)
            return [(stamp_ns + shift_ns, item)]
        if not known.goes_on(stamp_ns, arrived_ns):
            return self._doubt(sender, known, Stamped(stamp_ns, arrived_ns, item))
        waited = self._leave(sender, known) if known.waiting else []
        known.alone = False
        if stamp_ns > known.stamp_ns:
            known.stamp_ns, known.arrived_ns = stamp_ns, arrived_ns
            self._now_ns, self._now_arrived_ns = stamp_ns + known.shift_ns, arrived_ns
        return [*waited, (stamp_ns + known.shift_ns, item)]

    def end(self) -> list[tuple[int, Item]]:
        """Nothing more will come: what waits took a step that others took too, or is late or stray."""
        return [
            found for sender, known in self._senders.items() if known.waiting for found in self._settle(sender, known)
        ]

    def _settle(self, sender: Hashable, known: _Sender[Item]) -> list[tuple[int, Item]]:
        first = known.waiting[0]
        shift_ns = self._step_of_others(known, first.stamp_ns, first.arrived_ns)
        return self._leave(sender, known) if shift_ns is None else self._take_step(sender, known, shift_ns)

    def _step_of_others(self, known: _Sender[Item], stamp_ns: int, arrived_ns: int) -> int | None:
        """The shift [ns] of a step that other senders took, if it brings a stamp to the present; else None."""
        shift_ns = self._shift_near(stamp_ns, arrived_ns)
        near = abs(stamp_ns + shift_ns - self._now_at(arrived_ns)) <= SAME_NS
        return shift_ns if self.jumped and near and shift_ns != known.shift_ns else None

    def _now_at(self, arrived_ns: int) -> int:
        """What the timeline shows at an arrival [ns]."""
        return self._now_ns + arrived_ns - self._now_arrived_ns

    def moved(self, stamp_ns: int, arrived_ns: int) -> int:
        """Where a single stamp [ns] that arrived then stands on the timeline."""
        return stamp_ns + self._shift_near(stamp_ns, arrived_ns)

    def _shift_near(self, stamp_ns: int, arrived_ns: int) -> int:
        """Of all shifts the one that brings a stamp nearest to what the timeline shows at an arrival [ns]."""
        if len(self._shifts) == 1:
            return 0
        now_ns = self._now_at(arrived_ns)
        return min(reversed(self._shifts), key=lambda shift: abs(stamp_ns + shift - now_ns))

    def _doubt(self, sender: Hashable, known: _Sender[Item], stamped: Stamped[Item]) -> list[tuple[int, Item]]:
        left: list[tuple[int, Item]] = []
        if known.waiting and not known.waits_for(stamped.stamp_ns, stamped.arrived_ns):
            left = self._leave(sender, known)
        known.waiting.append(stamped)
        shift_ns = self._step_of_others(known, stamped.stamp_ns, stamped.arrived_ns)
        if shift_ns is not None:
            return [*left, *self._take_step(sender, known, shift_ns)]
        if len(known.waiting) < CONFIRMED:
            return left
        return [*left, *self._decide(sender, known)]

    def _decide(self, sender: Hashable, known: _Sender[Item]) -> list[tuple[int, Item]]:
        """What several stamps in a row say, once they have taken long enough."""
        first, last = known.waiting[0], known.waiting[-1]
        took_ns = last.arrived_ns - first.arrived_ns
        quick = last.stamp_ns - first.stamp_ns > LIVE_RATE * took_ns + BACK_NS
        behind_ns = known.stamp_ns - first.stamp_ns
        if known.alone and not 0 < behind_ns <= LATE_NS:
            return self._begin_again(sender, known)
        if quick:
            return self._leave(sender, known) if 0 < behind_ns <= LATE_NS else self._go_on(known)
        return self._step(sender, known) if took_ns >= LIVE_NS else []

    def _go_on(self, known: _Sender[Item]) -> list[tuple[int, Item]]:
        """Time runs at another rate here: the stamps are what they are, and the sender goes on from them."""
        waiting, known.waiting = known.waiting, []
        known.stamp_ns, known.arrived_ns = waiting[-1].stamp_ns, waiting[-1].arrived_ns
        return [(stamped.stamp_ns + known.shift_ns, stamped.item) for stamped in waiting]

    def _begin_again(self, sender: Hashable, known: _Sender[Item]) -> list[tuple[int, Item]]:
        """Nothing has followed the first stamp: it was the stray one."""
        off_ns = known.stamp_ns - known.waiting[0].stamp_ns
        self.strays.append(Stray(sender, known.arrived_ns, known.stamp_ns, off_ns))
        known.alone = False
        return self._go_on(known)

    def _step(self, sender: Hashable, known: _Sender[Item]) -> list[tuple[int, Item]]:
        """The first sender to take a step: from here on its stamps are moved so that time goes on."""
        first = known.waiting[0]
        shift_ns = max(self._now_at(first.arrived_ns), known.stamp_ns + known.shift_ns) - first.stamp_ns
        self._shifts.append(shift_ns)
        taken = self._take_step(sender, known, shift_ns)
        self._now_ns, self._now_arrived_ns = known.stamp_ns + shift_ns, known.arrived_ns
        for other in self._senders.values():
            if other.known_since_ns >= first.arrived_ns:
                other.shift_ns = self._shift_near(other.stamp_ns, other.arrived_ns)
        return taken

    def _take_step(self, sender: Hashable, known: _Sender[Item], shift_ns: int) -> list[tuple[int, Item]]:
        first = known.waiting[0]
        jump_ns = first.stamp_ns - known.stamp_ns - (first.arrived_ns - known.arrived_ns)
        self.steps.append(Step(sender, first.arrived_ns, shift_ns, jump_ns))
        known.shift_ns, known.alone = shift_ns, False
        return self._go_on(known)

    def _leave(self, sender: Hashable, known: _Sender[Item]) -> list[tuple[int, Item]]:
        """The sender goes on where it was: what waited is late, or stray."""
        waiting, known.waiting = known.waiting, []
        late: list[tuple[int, Item]] = []
        for stamped in waiting:
            off_ns = stamped.stamp_ns - known.stamp_ns
            if -LATE_NS <= off_ns <= 0:
                late.append((stamped.stamp_ns + known.shift_ns, stamped.item))
            else:
                self.strays.append(Stray(sender, stamped.arrived_ns, stamped.stamp_ns, off_ns))
        return late
