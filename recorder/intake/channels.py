"""The numbers of a recording's channels: one for each topic and Zenoh encoding in it.

MCAP numbers channels with 16 bits. So they are counted anew for every recording, and the last numbers are kept for
what learning needs: however many other keys a cell has, its poses and actions get in.
"""

from __future__ import annotations

from typing import Final

MOST: Final = 65535
"""The largest number of a channel."""
KEPT: Final = 1024
"""So many of the numbers are kept for what learning needs."""


class Channels:
    """Numbers from 1 on. Not safe for threads that add: their owner holds a lock; those that `describe` need none."""

    def __init__(self) -> None:
        self._described: list[tuple[str, str]] = [("", "")]
        self._numbers: dict[tuple[str, str], int] = {}

    def number(self, topic: str, encoding: str, essential: bool) -> int:
        """The number of a channel, new or known; 0 if there is no more room."""
        known = self._numbers.get((topic, encoding))
        if known is not None:
            return known
        number = len(self._described)
        if number > (MOST if essential else MOST - KEPT):
            return 0
        self._described.append((topic, encoding))
        self._numbers[topic, encoding] = number
        return number

    def describe(self, number: int) -> tuple[str, str]:
        """The topic and the Zenoh encoding of a channel."""
        return self._described[number]
