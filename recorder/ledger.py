"""The loss ledger: which sequence numbers of which source arrived, and which did not.

A publisher that numbers its samples makes every loss countable; one that does not makes losses unknowable, and the
ledger says so (`None`) instead of saying nothing was lost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field
from typing import Final

Source = Hashable
"""A publisher: the session it lives in and its number there."""
_WRAP: Final = 1 << 32
"""Sequence numbers are 32 bits wide and begin anew after the last."""
_MOST_RANGES: Final = 4096
"""So many separate gaps of a source are kept apart; the oldest beyond that are counted but can no longer be filled."""


@dataclass
class Gap:
    """Numbers `first` to `last` (both missing) of a source on a topic, noticed at `noticed_ns` (receive time)."""

    topic: str
    source: Source
    first: int
    last: int
    noticed_ns: int
    asked: int = 0
    """How often the publisher's cache was asked for them."""
    hopeless: bool = False
    """The publisher no longer has them."""

    @property
    def count(self) -> int:
        """How many samples are missing."""
        return self.last - self.first + 1


@dataclass
class _Account:
    """One source: the number it will use next, and what is missing before that."""

    topic: str
    next: int
    gaps: list[Gap] = field(default_factory=list)
    settled: int = 0
    """Missing samples whose gaps are no longer kept apart."""


class Ledger:
    """Counts arrivals by source and sequence number over the life of the recorder, losses by recording.

    Not safe for threads: its owner holds a lock.
    """

    def __init__(self) -> None:
        self._accounts: dict[Source, _Account] = {}
        self._unnumbered: set[str] = set()
        self._numbered: set[str] = set()
        self._refused: Counter[str] = Counter()
        self._counting = False

    def begin(self) -> None:
        """A recording begins: what was missing before does not concern it."""
        self.forget()
        self._counting = True

    def pause(self) -> None:
        """What is missed from now on is not missing from the recording."""
        self._counting = False

    def resume(self) -> None:
        """The recording goes on."""
        self._counting = True

    def forget(self) -> None:
        """No recording: arrivals go on being followed, losses are not kept."""
        self._counting = False
        self._unnumbered.clear()
        self._numbered.clear()
        self._refused.clear()
        for account in self._accounts.values():
            account.gaps.clear()
            account.settled = 0

    def arrived(self, topic: str, source: Source, number: int, now_ns: int) -> bool:
        """A numbered sample is here. Returns False if it was here before, or was given up before the recording."""
        account = self._accounts.get(source)
        if account is None:
            account = self._accounts[source] = _Account(topic, number)
        if self._counting:
            self._numbered.add(topic)
        if number == account.next:
            account.next = (number + 1) % _WRAP
            return True
        return self._out_of_order(account, source, number, now_ns)

    def arrived_unnumbered(self, topic: str) -> None:
        """A sample without a number is here."""
        if self._counting:
            self._unnumbered.add(topic)

    def heard(self, topic: str, source: Source, last: int, now_ns: int) -> None:
        """A heartbeat says that `last` was the source's newest number."""
        account = self._accounts.setdefault(source, _Account(topic, (last + 1) % _WRAP))
        self._up_to(account, source, (last + 1) % _WRAP, now_ns)

    def appeared(self, topic: str, source: Source) -> None:
        """A source unknown until now came to the network during the recording: its numbers begin at 0."""
        if self._counting:
            self._accounts.setdefault(source, _Account(topic, 0))

    def knows(self, source: Source) -> bool:
        """Whether anything of this source was ever heard."""
        return source in self._accounts

    def expected(self, source: Source) -> int:
        """The number that the source will use next, as far as known."""
        account = self._accounts.get(source)
        return account.next if account else 0

    def began_late(self, source: Source, first: int) -> None:
        """What this source published before its number `first` was before the recording: it is not missing."""
        account = self._accounts.get(source)
        if account:
            self._trim(account, first)

    def refused(self, topic: str, source: Source | None, number: int, now_ns: int) -> None:
        """A sample arrived but could not be kept (memory or disk full): it is lost for good."""
        self._refused[topic] += 1
        if source is not None:
            self._refused_numbered(topic, source)

    def unwritten(self, topic: str, count: int) -> None:
        """Samples that had been kept could not be written."""
        self._refused[topic] += count
        for account in self._accounts.values():
            if account.topic == topic:
                account.settled += count
                return

    def _refused_numbered(self, topic: str, source: Source) -> None:
        account = self._accounts.get(source)
        if account is not None:
            account.settled += 1

    @property
    def gaps(self) -> list[Gap]:
        """What is missing from the recording and may still be filled."""
        return [gap for account in self._accounts.values() for gap in account.gaps]

    @property
    def refusals(self) -> dict[str, int]:
        """Samples by topic that arrived but could not be kept, numbered or not."""
        return dict(self._refused)

    def lost(self, topics: Iterable[str] = ()) -> dict[str, int | None]:
        """Missing samples by topic, also of these; None where a publisher without numbers makes it unknowable."""
        numbered = {account.topic for account in self._accounts.values()}
        counts: dict[str, int | None] = {topic: 0 if topic in numbered else None for topic in topics}
        counts |= dict.fromkeys(self._numbered, 0)
        for account in self._accounts.values():
            missing = account.settled + sum(gap.count for gap in account.gaps)
            if missing:
                counts[account.topic] = (counts.get(account.topic) or 0) + missing
        return dict(sorted({**counts, **dict.fromkeys(self._unnumbered)}.items()))

    def close(self, topics: Iterable[str]) -> tuple[dict[str, int | None], dict[str, int]]:
        """The recording has ended: its losses and its refusals; both are forgotten."""
        result = self.lost(topics), self.refusals
        self.forget()
        return result

    def split(self, topics: Iterable[str]) -> dict[str, int | None]:
        """The losses of the part that ends here; what may still be filled concerns the next part."""
        pending = {
            source: [gap for gap in account.gaps if not gap.hopeless] for source, account in self._accounts.items()
        }
        for account in self._accounts.values():
            account.gaps[:] = [gap for gap in account.gaps if gap.hopeless]
        lost = self.lost(topics)
        self.begin()
        for source, gaps in pending.items():
            self._accounts[source].gaps[:] = gaps
        return lost

    def _out_of_order(self, account: _Account, source: Source, number: int, now_ns: int) -> bool:
        if (number - account.next) % _WRAP < _WRAP // 2:
            self._up_to(account, source, number, now_ns)
            account.next = (number + 1) % _WRAP
            return True
        return self._fill(account, number)

    def _up_to(self, account: _Account, source: Source, upcoming: int, now_ns: int) -> None:
        """Everything from the expected number to the one before `upcoming` is missing."""
        missing = (upcoming - account.next) % _WRAP
        if not 0 < missing < _WRAP // 2:
            return
        if self._counting:
            account.gaps.append(Gap(account.topic, source, account.next, account.next + missing - 1, now_ns))
            while len(account.gaps) > _MOST_RANGES:
                account.settled += account.gaps.pop(0).count
        account.next = upcoming

    def _fill(self, account: _Account, number: int) -> bool:
        for index, gap in enumerate(account.gaps):
            if gap.first <= number <= gap.last:
                account.gaps[index : index + 1] = _without(gap, number)
                return True
        return False

    def _trim(self, account: _Account, first: int) -> None:
        kept = [gap for gap in account.gaps if gap.last >= first]
        for gap in kept:
            gap.first = max(gap.first, first)
        account.gaps[:] = kept


def _without(gap: Gap, number: int) -> list[Gap]:
    """What is left of a gap once one number in it has arrived."""
    rest = ((gap.first, number - 1), (number + 1, gap.last))
    return [
        Gap(gap.topic, gap.source, first, last, gap.noticed_ns, gap.asked, gap.hopeless)
        for first, last in rest
        if first <= last
    ]
