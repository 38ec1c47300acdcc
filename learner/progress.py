"""What is being done at the moment, for whoever waits: long work tells it, a caller that shows it listens."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final

Hear = Callable[[str], None]
"""Called with a few words, such as `rehearsing, rollout 3`; it must be quick and must not raise."""

_HEARD: Final[ContextVar[Hear | None]] = ContextVar("heard", default=None)


def tell(doing: str) -> None:
    """Say what is being done from now on; nothing happens where nobody listens."""
    hear = _HEARD.get()
    if hear is not None:
        hear(doing)


def is_heard() -> bool:
    """Whether somebody listens: then one thread may show it, and holds nothing that the learner needs."""
    return _HEARD.get() is not None


@contextmanager
def heard_by(hear: Hear) -> Iterator[None]:
    """Within the block, `hear` is called with what is told in this thread."""
    before = _HEARD.set(hear)
    try:
        yield
    finally:
        _HEARD.reset(before)
