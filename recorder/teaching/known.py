"""Which frames the cell's poses tell of, so that a demonstration does not begin with names that nobody publishes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import Final

from recorder.errors import PayloadError
from recorder.wire import NS, parse_transforms

KNOWN_NS: Final = 60 * NS
"""What was told so long ago [ns] is not there any more."""
MOST: Final = 4096
"""So many frames are remembered, those told last."""


class Known:
    """The child frames of the last minute's poses, each with its parents. Not safe for threads."""

    def __init__(self) -> None:
        self._told: OrderedDict[tuple[str, str], int] = OrderedDict()
        self._newest_ns = 0

    def take(self, payload: bytes, arrived_ns: int) -> None:
        """Take in a message of /poses that arrived at a log time [ns]; what is none tells nothing."""
        try:
            transforms = parse_transforms(payload)
        except PayloadError:
            # Who records is told of it by the sightings of the demonstration; here it only tells no names.
            return
        self._newest_ns = max(self._newest_ns, arrived_ns)
        for transform in transforms:
            pair = (transform.child_frame_id, transform.parent_frame_id)
            self._told[pair] = arrived_ns
            self._told.move_to_end(pair)
        while len(self._told) > MOST:
            self._told.popitem(last=False)

    def missing(self, wanted: Mapping[str, str], base_frame: str, now_ns: int) -> str | None:
        """What of `wanted` the poses do not tell of in the base frame, as a sentence; None if they tell of all.

        `wanted` says of each name what it is, such as 'object'.
        """
        told = [pair for pair, arrived_ns in self._told.items() if now_ns - arrived_ns <= KNOWN_NS]
        children = {child for child, parent in told if parent == base_frame}
        absent = [f"the {what} {name}" for name, what in wanted.items() if name not in children]
        if not absent:
            return None
        if not told:
            return "no poses are published in this cell"
        return f"the cell's poses do not tell of {_listed(absent)}; they tell of {_told(told)}"


def _listed(words: Sequence[str], most: int = 6) -> str:
    more = [f"{len(words) - most} more"] if len(words) > most else []
    return ", ".join([*words[:most], *more])


def _told(pairs: Sequence[tuple[str, str]]) -> str:
    parents: dict[str, list[str]] = {}
    for child, parent in sorted(pairs):
        parents.setdefault(parent, []).append(child)
    return "; ".join(f"{_listed(children)} in {parent}" for parent, children in sorted(parents.items())[:3])
