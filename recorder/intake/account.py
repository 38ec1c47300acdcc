"""The account of one publisher: which of its sequence numbers were heard, and which are missing.

A publisher that is started again under the same id numbers its samples from 0 again. It is told from samples that
arrive twice by the moment of publication: the same number with another stamp is another sample. Later samples of its
second life may have arrived before that one, as if the first life had gone on; their stamps tell which life is theirs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Final

Source = tuple[str, int]
"""A publisher: the id of its session and its number there."""
WRAP: Final = 1 << 32
"""Sequence numbers are 32 bits wide and begin anew after the last."""
_MEMORY: Final = 1024
"""Of so many of a source's last samples the stamps are remembered."""
LONGEST_GAP: Final = 1 << 24
"""More was never missing at once: numbers that jump further have begun anew."""
MOST_GAPS: Final = 1024
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


@dataclass(frozen=True)
class Loss:
    """Samples of a topic that were lost for good between two moments [ns]."""

    topic: str
    count: int
    begin_ns: int
    end_ns: int


@dataclass
class Account:
    """One source: the first number heard of, the one it will use next, and what is missing before that."""

    topic: str
    source: Source
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

    def add_next(self, number: int, stamp_ns: int) -> None:
        """The expected number has arrived."""
        self.next = (number + 1) % WRAP
        self.seen_ns = stamp_ns
        self._remember(number, stamp_ns)

    def add_missing(self, number: int, stamp_ns: int) -> Gap | None:
        """A number of the past has arrived; the gap in which it was missing, None if it was not."""
        filled = self._fill(number)
        if filled is not None:
            self._remember(number, stamp_ns)
        return filled

    def skip_to(self, upcoming: int, stamp_ns: int, counted: bool) -> None:
        """Everything from the expected number to the one before `upcoming` is missing."""
        missing = (upcoming - self.next) % WRAP
        if not 0 < missing < WRAP // 2:
            return
        last = self.next + missing - 1
        self.gaps.append(Gap(self.topic, self.source, self.next, last, self.seen_ns, stamp_ns, counted))
        self.next = upcoming
        if len(self.gaps) > MOST_GAPS:
            _join_oldest(self.gaps)

    def began_anew(self, number: int, stamp_ns: int, cached: bool) -> bool:
        """Whether a sample with a number of the past is none of the past ones, but of a publisher that returned."""
        known = self.stamps.get(number)
        if known is not None:
            return known != stamp_ns
        far = (self.next - number) % WRAP > _MEMORY
        return stamp_ns > self.seen_ns or (far and not cached)

    def take_second_life(self, number: int, stamp_ns: int, counted: bool) -> Account:
        """Take the second life of a publisher that began anew out of this account, which stays that of its first.

        `number`, published at `stamp_ns`, is the sample that told of it. The numbers begin at 0, unless it says one
        that nobody can have come to.
        """
        first = 0 if number < LONGEST_GAP else number
        began = Account(self.topic, self.source, first, first, self.seen_ns, counted)
        began.stamps = self._stamps_of_second_life(number, stamp_ns)
        if began.stamps:
            last = min((self._age(known), known) for known in self.stamps if known not in began.stamps)[1]
            self._hand_over(began, last, stamp_ns)
        return began

    def _hand_over(self, began: Account, last: int, stamp_ns: int) -> None:
        """What comes after the `last` number of the first life is the second's; what the second's samples have filled
        before it is missing again.
        """
        began.skip_to(last + 1, stamp_ns, began.counted)
        began.next = self.next
        began.gaps += [gap for gap in self.gaps if self._age(gap.first) < self._age(last)]
        self.gaps = [gap for gap in self.gaps if self._age(gap.first) >= self._age(last)]
        for taken, at_ns in began.stamps.items():
            if began._fill(taken) is not None:
                self.gaps.append(Gap(self.topic, self.source, taken, taken, at_ns, at_ns, began.counted))

    def losses(self) -> list[Loss]:
        """What is missing from the recording."""
        return [Loss(gap.topic, gap.count, gap.begin_ns, gap.end_ns) for gap in self.gaps if gap.counted]

    def _stamps_of_second_life(self, number: int, stamp_ns: int) -> dict[int, int]:
        """Those of the remembered samples that cannot be of the first life, since numbers go up with time in each."""
        before_ns = self.stamps.get(number)
        if before_ns is None:
            return {}
        forward = stamp_ns > before_ns

        def is_second(known: int, at_ns: int) -> bool:
            later = self._age(known) < self._age(number)
            bound_ns = stamp_ns if later == forward else before_ns
            return at_ns >= bound_ns if forward else at_ns < bound_ns

        return {known: at_ns for known, at_ns in self.stamps.items() if known != number and is_second(known, at_ns)}

    def _age(self, number: int) -> int:
        return (self.next - number) % WRAP

    def _remember(self, number: int, stamp_ns: int) -> None:
        self.stamps[number] = stamp_ns
        if len(self.stamps) >= 2 * _MEMORY:
            for old in list(islice(self.stamps, _MEMORY)):
                del self.stamps[old]

    def _fill(self, number: int) -> Gap | None:
        for index, gap in enumerate(self.gaps):
            if gap.first <= number <= gap.last and not gap.extra:
                self.gaps[index : index + 1] = gap.without(number)
                return gap
        return None


def _join_oldest(gaps: list[Gap]) -> None:
    """Tell the two oldest gaps as one that nothing fills any more; its count stays exact."""
    one, two = gaps[0], gaps[1]
    if not one.counted:
        del gaps[0]
        return
    count = one.count + (two.count if two.counted else 0)
    joined = replace(one, last=two.last, end_ns=two.end_ns, hopeless=True, extra=count - (two.last - one.first + 1))
    gaps[0:2] = [joined]
