"""What a recorder says by itself: events for everyone who listens, and alarms, which its status repeats."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Final, Self

import zenoh

from recorder.notices import Notices
from recorder.wire import JSON_ENCODING, json_message

MOST_ALARMS: Final = 20

OnEvent = Callable[[dict[str, Any]], None]


class Voice:
    """Publishes events on a key, as a context; `on_event` gets each of them too. Safe for threads."""

    def __init__(self, session: zenoh.Session, key: str, on_event: OnEvent) -> None:
        self._session, self._key, self._on_event = session, key, on_event
        self._alarms: deque[str] = deque(maxlen=MOST_ALARMS)
        self._opened = ExitStack()

    def __enter__(self) -> Self:
        self._publisher = self._opened.enter_context(self._session.declare_publisher(self._key))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    @property
    def alarms(self) -> list[str]:
        """The last alarms, oldest first."""
        return list(self._alarms)

    def tell(self, event: str, **more: Any) -> None:
        """Publish an event."""
        told = {"stamp_ns": time.time_ns(), "event": event, **more}
        self._publisher.put(json_message(told), encoding=JSON_ENCODING)
        self._on_event(told)

    def alarm(self, sentence: str) -> None:
        """Say what somebody should do something about."""
        self._alarms.append(sentence)
        self.tell("alarm", alarm=sentence)

    def tell_recovery(self, fate: str, sentence: str) -> None:
        """Say what became of a recording that was found unfinished."""
        self.tell("recovery", fate=fate, sentence=sentence)
        self._alarms.append(sentence)

    def tell_notices(self, notices: Notices) -> None:
        """Say what is newly odd about the demonstration."""
        for sentence in notices.take_untold():
            self.alarm(sentence)

    def forget(self) -> None:
        """Another demonstration begins: the alarms concern the last one."""
        self._alarms.clear()
