"""The loss ledger: which sequence numbers of which source arrived, and which did not.

A publisher that numbers its samples makes every loss countable; one that does not makes losses unknowable, and the
ledger says so (`None`) instead of saying nothing was lost.

A publisher that is started again under the same id numbers its samples from 0 again. It is told from samples that
arrive twice by the moment of publication: the same number with another stamp is another sample.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Final

Source = tuple[str, int]
"""A publisher: the id of its session and its number there."""
_WRAP: Final = 1 << 32
"""Sequence numbers are 32 bits wide and begin anew after the last."""
_MEMORY: Final = 1024
"""Of so many of a source's last samples the stamps are remembered."""
_LONGEST_GAP: Final = 1 << 24
"""More was never missing at once: numbers that jump further have begun anew."""
_MOST_GAPS: Final = 1024
"""So many separate gaps of a source are kept apart; beyond that the two oldest are told as one."""


@dataclass
class Gap:
    """Numbers `first` to `last` (both missing) of a source, published between two moments [ns].

    `counted` gaps belong to the recording. `hopeless` ones are no longer in the publisher's cache. `extra` corrects
    the count where gaps were told as one.
    """

    topic: str
    source: Source
    first: int
    last: int
    begin_ns: int
    end_ns: int
    counted: bool
    asked: int = 0
    hopeless: bool = False
    extra: int = 0

    @property
    def count(self) -> int:
        """How many samples are missing."""
        return self.last - self.first + 1 + self.extra

    def without(self, number: int) -> Iterator[Gap]:
        """What is left once one number in it has arrived."""
        for first, last in ((self.first, number - 1), (number + 1, self.last)):
            if first <= last:
                yield replace(self, first=first, last=last)


@dataclass
class _Account:
    """One source: the first number heard of, the one it will use next, and what is missing before that."""

    topic: str
    first: int
    next: int
    seen_ns: int
    counted: bool
    """Whether it was first heard of during the present recording."""
    gaps: list[Gap] = field(default_factory=list)
    at_begin: int | None = None
    """The number that it was to use next when the present file began, if it was known then."""
    stamps: dict[int, int] = field(default_factory=dict)
    """When the last samples were published [ns], by number."""

    def forget_older(self) -> None:
        """Forget the older half of the stamps."""
        for old in list(islice(self.stamps, _MEMORY)):
            del self.stamps[old]

    def began_anew(self, number: int, stamp_ns: int, cached: bool) -> bool:
        """Whether a sample with a number of the past is none of the past ones, but of a publisher that returned."""
        known = self.stamps.get(number)
        if known is not None:
            return known != stamp_ns
        far = (self.next - number) % _WRAP > _MEMORY
        return stamp_ns > self.seen_ns or (far and not cached)


@dataclass(frozen=True)
class Loss:
    """Samples of a topic that were lost for good between two moments [ns]."""

    topic: str
    count: int
    begin_ns: int
    end_ns: int


class Ledger:
    """Counts arrivals by source and sequence number over the life of the recorder, losses by recording.

    Times are those of publication [ns]. Not safe for threads: its owner holds a lock.
    """

    def __init__(self) -> None:
        self._accounts: dict[Source, _Account] = {}
        self._unnumbered: set[str] = set()
        self._refused: list[Loss] = []
        self._most_refused = _MOST_GAPS
        self._unwritten: Counter[str] = Counter()
        self._ended: list[Loss] = []
        """What accounts that are closed had lost of the present recording."""
        self._counting = False
        self._restarts: Counter[str] = Counter()

    # --- the recording

    def begin(self) -> None:
        """A recording begins: what was missing before does not concern it."""
        self.forget()
        self._counting = True
        for account in self._accounts.values():
            account.at_begin = account.next

    def pause(self) -> None:
        """What is missed from now on is not missing from the recording."""
        self._counting = False

    def resume(self) -> None:
        """The recording goes on."""
        self._counting = True

    def forget(self) -> None:
        """No recording: arrivals go on being followed, and late ones let in, but nothing counts as lost."""
        self._counting = False
        self._unnumbered.clear()
        self._refused.clear()
        self._unwritten.clear()
        self._ended.clear()
        self._restarts.clear()
        for account in self._accounts.values():
            account.counted = False
            account.gaps[:] = [replace(gap, counted=False) for gap in account.gaps if not gap.hopeless]

    def split(self, topics: Iterable[str]) -> tuple[dict[str, int | None], list[Loss]]:
        """The losses of the part that ends here; what may still be filled concerns the next part."""
        pending: dict[Source, list[Gap]] = {}
        for source, account in self._accounts.items():
            pending[source] = [gap for gap in account.gaps if gap.counted and not gap.hopeless]
            account.gaps[:] = [gap for gap in account.gaps if gap not in pending[source]]
        ended = self.lost(topics), self.losses
        self.begin()
        for source, gaps in pending.items():
            self._accounts[source].gaps += gaps
        return ended

    # --- what arrives

    def arrived(self, topic: str, source: Source, number: int, stamp_ns: int, cached: bool = False) -> bool:
        """A numbered sample is here, from the network or out of the publisher's cache.

        Returns False if it was here before, or was given up before the recording. A source whose numbers have begun
        anew gets a new account, from 0 on; see `take_restarts`.
        """
        account = self._accounts.get(source)
        if account is None:
            account = self._accounts[source] = _Account(topic, number, number, stamp_ns, self._counting)
        if number != account.next:
            ahead = (number - account.next) % _WRAP
            if ahead >= _LONGEST_GAP:
                return self._arrived_behind(account, source, number, stamp_ns, cached)
            self._up_to(account, source, number, stamp_ns)
        account.next = (number + 1) % _WRAP
        account.seen_ns = stamp_ns
        account.stamps[number] = stamp_ns
        if len(account.stamps) >= 2 * _MEMORY:
            account.forget_older()
        return True

    def _arrived_behind(self, account: _Account, source: Source, number: int, stamp_ns: int, cached: bool) -> bool:
        if _fill(account, number):
            account.stamps[number] = stamp_ns
            return True
        if not account.began_anew(number, stamp_ns, cached):
            return False
        self._begin_anew(account, source, number)
        return self.arrived(account.topic, source, number, stamp_ns)

    def _begin_anew(self, account: _Account, source: Source, number: int) -> None:
        """Close the account of a publisher that is another one now; what it had lost stays lost.

        Its numbers begin at 0, unless it says one that nobody can have come to.
        """
        first = 0 if number < _LONGEST_GAP else number
        self._ended += _losses_of(account)
        if self._counting:
            self._restarts[account.topic] += 1
        self._accounts[source] = _Account(account.topic, first, first, account.seen_ns, self._counting)

    def take_restarts(self) -> Counter[str]:
        """How often publishers began anew in the present recording since the last call, by topic."""
        restarts, self._restarts = self._restarts, Counter()
        return restarts

    def arrived_unnumbered(self, topic: str) -> None:
        """A sample without a number is here."""
        if self._counting:
            self._unnumbered.add(topic)

    def refused(self, topic: str, source: Source | None, stamp_ns: int) -> None:
        """A sample arrived but could not be kept, because memory or disk is full: it is lost for good."""
        last = self._refused[-1] if self._refused else None
        if last is not None and last.topic == topic and source is not None:
            self._refused[-1] = replace(last, count=last.count + 1, end_ns=stamp_ns)
        else:
            self._refused.append(Loss(topic, 1, stamp_ns, stamp_ns))
        if len(self._refused) > self._most_refused:
            self._refused[:] = _merged(self._refused)
            self._most_refused = max(_MOST_GAPS, 2 * len(self._refused))

    def unwritten(self, topic: str, count: int) -> None:
        """Samples that had been kept could not be written."""
        self._unwritten[topic] += count

    # --- what publishers say of themselves

    def heard(self, topic: str, source: Source, last: int, stamp_ns: int) -> None:
        """The source itself says that `last` was its newest number.

        Of a source unknown until now, earlier samples may still be on their way: they are let in, and not missing.
        """
        upcoming = (last + 1) % _WRAP
        account = self._accounts.get(source)
        if account is None:
            on_their_way = Gap(topic, source, 0, last, stamp_ns, stamp_ns, counted=False)
            self._accounts[source] = _Account(topic, upcoming, upcoming, stamp_ns, False, [on_their_way])
        else:
            self._up_to(account, source, upcoming, stamp_ns)

    def appeared(self, topic: str, source: Source, stamp_ns: int) -> None:
        """A source came to the network during the recording: its numbers begin at 0."""
        if not self._counting:
            return
        account = self._accounts.setdefault(source, _Account(topic, 0, 0, stamp_ns, True))
        if account.counted and account.first > 0:
            account.gaps.insert(0, Gap(topic, source, 0, account.first - 1, stamp_ns, stamp_ns, counted=True))
            account.first = 0

    def began_late(self, source: Source, first: int) -> None:
        """What this source published before its number `first` was before the recording: it is not missing."""
        account = self._accounts.get(source)
        if account is None:
            return
        account.gaps[:] = [gap for gap in account.gaps if gap.last >= first]
        for gap in account.gaps:
            gap.first = max(gap.first, first)

    def knows(self, source: Source) -> bool:
        """Whether anything of this source was ever heard."""
        return source in self._accounts

    def expected(self, source: Source) -> int:
        """The number that the source will use next, as far as known."""
        return self._accounts[source].next

    def silent(self, source: Source, number: int) -> bool | None:
        """Whether `number` was a source's newest when the present file began, and still is; None if unknown then."""
        account = self._accounts.get(source)
        if account is None or account.at_begin is None:
            return None
        return account.at_begin == account.next == (number + 1) % _WRAP

    # --- what is missing

    @property
    def open_gaps(self) -> dict[Source, list[Gap]]:
        """What is missing from the recording and may still be had, by source."""
        found = {
            source: [gap for gap in account.gaps if gap.counted and not gap.hopeless]
            for source, account in self._accounts.items()
        }
        return {source: gaps for source, gaps in found.items() if gaps}

    @property
    def losses(self) -> list[Loss]:
        """What is missing from the recording, with its times."""
        gaps = [loss for account in self._accounts.values() for loss in _losses_of(account)]
        return [*self._ended, *gaps, *self._refused]

    @property
    def refusals(self) -> dict[str, int]:
        """Samples by topic that arrived but could not be kept or written, numbered or not."""
        counts = Counter(self._unwritten)
        for loss in self._refused:
            counts[loss.topic] += loss.count
        return dict(sorted(counts.items()))

    def lost(self, topics: Iterable[str] = ()) -> dict[str, int | None]:
        """Missing samples by topic, also of these; None where a publisher without numbers makes it unknowable."""
        numbered = {account.topic for account in self._accounts.values()}
        missing: Counter[str] = Counter(self._unwritten)
        for loss in self.losses:
            missing[loss.topic] += loss.count
        found = {*topics, *missing, *self._unnumbered}
        return {
            topic: missing[topic] if topic in numbered and topic not in self._unnumbered else None
            for topic in sorted(found)
        }

    def _up_to(self, account: _Account, source: Source, upcoming: int, stamp_ns: int) -> None:
        """Everything from the expected number to the one before `upcoming` is missing."""
        missing = (upcoming - account.next) % _WRAP
        if not 0 < missing < _WRAP // 2:
            return
        last = account.next + missing - 1
        account.gaps.append(
            Gap(account.topic, source, account.next, last, account.seen_ns, stamp_ns, counted=self._counting)
        )
        account.next = upcoming
        if len(account.gaps) > _MOST_GAPS:
            _join_oldest(account.gaps)


def _losses_of(account: _Account) -> list[Loss]:
    return [Loss(gap.topic, gap.count, gap.begin_ns, gap.end_ns) for gap in account.gaps if gap.counted]


def _fill(account: _Account, number: int) -> bool:
    for index, gap in enumerate(account.gaps):
        if gap.first <= number <= gap.last and not gap.extra:
            account.gaps[index : index + 1] = gap.without(number)
            return True
    return False


def _join_oldest(gaps: list[Gap]) -> None:
    """Tell the two oldest gaps as one that nothing fills any more; its count stays exact."""
    one, two = gaps[0], gaps[1]
    if not one.counted:
        del gaps[0]
        return
    count = one.count + (two.count if two.counted else 0)
    joined = replace(one, last=two.last, end_ns=two.end_ns, hopeless=True, extra=count - (two.last - one.first + 1))
    gaps[0:2] = [joined]


def _merged(losses: list[Loss]) -> list[Loss]:
    """One loss a topic, from the first moment to the last."""
    topics: dict[str, list[Loss]] = {}
    for loss in losses:
        topics.setdefault(loss.topic, []).append(loss)
    return [
        Loss(topic, sum(each.count for each in same), same[0].begin_ns, same[-1].end_ns)
        for topic, same in topics.items()
    ]
