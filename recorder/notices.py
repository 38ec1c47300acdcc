"""What was odd about a demonstration: told once as an alarm, counted, and written into the file."""

from __future__ import annotations

import threading
from typing import Final

MOST: Final = 100
"""So many different sentences are kept; of further ones only the number."""


class Notices:
    """Sentences and how often each was true. Safe for threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: dict[str, int] = {}
        self._untold: list[str] = []
        self._beyond = 0

    def add(self, sentence: str, count: int = 1) -> None:
        """Note something; a sentence that is known is only counted."""
        with self._lock:
            if sentence in self._counts:
                self._counts[sentence] += count
            elif len(self._counts) < MOST:
                self._counts[sentence] = count
                self._untold.append(sentence)
            else:
                self._beyond += count

    @property
    def untold(self) -> bool:
        """Whether a sentence is new."""
        return bool(self._untold)

    def take_untold(self) -> list[str]:
        """The sentences that are new since the last call."""
        with self._lock:
            untold, self._untold = self._untold, []
        return untold

    @property
    def sentences(self) -> tuple[str, ...]:
        """All there is to say, with numbers."""
        with self._lock:
            told = [f"{sentence} ({count} times)" if count > 1 else sentence
                    for sentence, count in self._counts.items()]  # fmt: skip
            return (*told, *([f"and {self._beyond} more oddities"] if self._beyond else []))

    def clear(self) -> None:
        """Forget everything: another demonstration begins."""
        with self._lock:
            self._counts.clear()
            self._untold.clear()
            self._beyond = 0
