"""The loss ledger: which sequence numbers of which source arrived, and which did not.

A publisher that numbers its samples makes every loss countable; one that does not makes losses unknowable, and the
ledger says so (`None`) instead of saying nothing was lost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from recorder.intake.account import LONGEST_GAP, MOST_GAPS, WRAP, Account, Gap, Loss, Source


@dataclass(frozen=True)
class Balance:
    """What a recording has lost: by topic (None: unknowable), one by one, and what of it had come but was not kept."""

    lost: Mapping[str, int | None]
    losses: Sequence[Loss]
    refusals: Mapping[str, int]


class Ledger:
    """Counts arrivals by source and sequence number over the life of the recorder, losses by recording.

    Times are those of publication [ns]. Not safe for threads: its owner holds a lock.
    """

    def __init__(self) -> None:
        self._accounts: dict[Source, Account] = {}
        self._unnumbered: set[str] = set()
        self._refused: list[Loss] = []
        self._most_refused = MOST_GAPS
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

    def balance(self, topics: Iterable[str]) -> Balance:
        """What the recording has lost until now; of these topics it is told in any case."""
        return Balance(self.lost(topics), self.losses, self.refusals)

    def split(self, topics: Iterable[str]) -> Balance:
        """The losses of the part that ends here; what may still be filled concerns the next part."""
        pending: dict[Source, list[Gap]] = {}
        for source, account in self._accounts.items():
            pending[source] = [gap for gap in account.gaps if gap.counted and not gap.hopeless]
            account.gaps[:] = [gap for gap in account.gaps if gap not in pending[source]]
        ended = self.balance(topics)
        self.begin()
        for source, gaps in pending.items():
            self._accounts[source].gaps += gaps
        return ended

    # --- what arrives

    def arrived(self, topic: str, source: Source, number: int, stamp_ns: int, cached: bool = False) -> bool:
        """A numbered sample is here, from the network or out of the publisher's cache.

        Returns False if it was here before, or was given up before the recording; and out of a cache, if it was
        published when nothing was recorded. A source whose numbers have begun
        anew gets a new account, from 0 on; see `take_restarts`.
        """
        account = self._accounts.get(source)
        if account is None:
            account = self._accounts[source] = Account(topic, source, number, number, stamp_ns, self._counting)
        if number != account.next:
            ahead = (number - account.next) % WRAP
            if ahead >= LONGEST_GAP:
                return self._arrived_behind(account, number, stamp_ns, cached)
            account.skip_to(number, stamp_ns, self._counting)
        account.add_next(number, stamp_ns)
        return True

    def _arrived_behind(self, account: Account, number: int, stamp_ns: int, cached: bool) -> bool:
        filled = account.add_missing(number, stamp_ns)
        if filled is not None:
            return filled.counted or not cached
        if not account.began_anew(number, stamp_ns, cached):
            return False
        self._begin_anew(account, number, stamp_ns)
        return self.arrived(account.topic, account.source, number, stamp_ns)

    def _begin_anew(self, account: Account, number: int, stamp_ns: int) -> None:
        """Close the account of a publisher that is another one now; what it had lost stays lost."""
        self._accounts[account.source] = account.take_second_life(number, stamp_ns, self._counting)
        self._ended += account.losses()
        if self._counting:
            self._restarts[account.topic] += 1

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
            self._most_refused = max(MOST_GAPS, 2 * len(self._refused))

    def unwritten(self, topic: str, count: int) -> None:
        """Samples that had been kept could not be written."""
        self._unwritten[topic] += count

    # --- what publishers say of themselves

    def heard(self, topic: str, source: Source, last: int, stamp_ns: int) -> None:
        """The source itself says that `last` was its newest number.

        Of a source unknown until now, earlier samples may still be on their way: they are let in, and not missing.
        """
        upcoming = (last + 1) % WRAP
        account = self._accounts.get(source)
        if account is None:
            on_their_way = Gap(topic, source, 0, last, stamp_ns, stamp_ns, counted=False)
            self._accounts[source] = Account(topic, source, upcoming, upcoming, stamp_ns, False, [on_their_way])
        else:
            account.skip_to(upcoming, stamp_ns, self._counting)

    def appeared(self, topic: str, source: Source, stamp_ns: int) -> None:
        """A source came to the network during the recording: its numbers begin at 0."""
        if not self._counting:
            return
        account = self._accounts.setdefault(source, Account(topic, source, 0, 0, stamp_ns, True))
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
        return account.at_begin == account.next == (number + 1) % WRAP

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
        gaps = [loss for account in self._accounts.values() for loss in account.losses()]
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


def _merged(losses: list[Loss]) -> list[Loss]:
    """One loss a topic, from the first moment to the last."""
    topics: dict[str, list[Loss]] = {}
    for loss in losses:
        topics.setdefault(loss.topic, []).append(loss)
    return [
        Loss(topic, sum(each.count for each in same), same[0].begin_ns, same[-1].end_ns)
        for topic, same in topics.items()
    ]
