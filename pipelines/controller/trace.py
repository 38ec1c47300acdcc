"""What a controller did: JSON Lines, one event a line, each with `stamp_ns`, `tick` and `event`."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from pipelines.errors import CommandError


class Trace:
    """The file of one run, open within a `with` block; every line is handed to the system when it is written.

    Raises CommandError on entering if the file cannot be made: no run without a trace. `hear` is called with each event
    that was written, and what is known of it.
    """

    def __init__(self, path: Path, hear: Callable[[str, dict[str, Any]], None] = lambda event, facts: None) -> None:
        self.path, self._hear = path, hear
        self.tick = 0
        """The number of the tick that events belong to; 0 before the first."""

    def __enter__(self) -> Self:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("x", encoding="utf-8", buffering=1)
        except OSError as error:
            raise CommandError(f"cannot write the trace {self.path}: {error.strerror}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()

    def write(self, event: str, **facts: Any) -> None:
        """Append an event of this moment. Raises OSError if the disk does not take it."""
        line = {"stamp_ns": time.time_ns(), "tick": self.tick, "event": event, **facts}
        self._file.write(json.dumps(line, sort_keys=False) + "\n")
        self._hear(event, facts)
