"""A process that is kept alive: started again whenever it ended or does not answer, and told of when that changes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Final, Self

from pipelines.service.child import Child, ChildFailedError

LOOK_S: Final = 0.5
PAUSES_S: Final = (0.0, 1.0, 5.0, 15.0, 60.0)
"""Before each new start in a row; the last for all further ones."""
SILENT_S: Final = 10.0
"""One that does not answer for so long is said to be down [s]."""
HOPELESS_S: Final = 60.0
"""And after so long it is ended and started again [s]; a database that is locked may be free by then."""

Tell = Callable[[Mapping[str, Any]], None]


class Keeper:
    """Keeps the process that `make` makes, from entering to leaving its context.

    It is up once `ready` says so, and down when it has ended or `ready` has said otherwise for a while. `tell` gets
    {"event": "down", "what", "reason"} and {"event": "up", "what"} when that changes, the first time it is up excepted.
    """

    def __init__(self, make: Callable[[], Child], ready: Callable[[Child], bool], tell: Tell, start_s: float) -> None:
        self._make, self._ready, self._tell, self._start_s = make, ready, tell, start_s
        self._stop, self._settled = threading.Event(), threading.Event()
        self._child: Child | None = None
        self._up, self._told = False, ""
        self._thread = threading.Thread(target=self._keep, name="keeper")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()

    @property
    def up(self) -> bool:
        """Whether the process answers."""
        return self._up

    def wait(self, stop: threading.Event) -> bool:
        """Wait until the first start came to an end, or `stop` is set; whether the process is up."""
        while not self._settled.wait(LOOK_S / 2) and not stop.is_set():
            pass
        return self._up

    def send(self, document: Mapping[str, Any]) -> bool:
        """Tell the process something; False if it is not there to hear it."""
        child = self._child
        return child is not None and child.tell(document)

    def _keep(self) -> None:
        """In a thread of its own, for a process is told to end when the thread that started it does."""
        failed = 0
        while not self._stop.wait(PAUSES_S[min(failed, len(PAUSES_S) - 1)]):
            begun_s = time.monotonic()
            reason = self._live()
            if reason is not None:
                self._is_down(reason)
            failed = 0 if self._stop.is_set() or time.monotonic() - begun_s > self._start_s else failed + 1

    def _live(self) -> str | None:
        """One life of the process: why it is over, None where it was ended by us, as it should."""
        self._child = self._make()
        try:
            with self._child as child:
                self._watch(child)
        except ChildFailedError as error:
            return str(error)
        except Exception as error:  # noqa: BLE001  # whatever it was, the process is started again and the reason told
            return f"the {self._child.name} could not be kept: {type(error).__name__}: {error}"
        finally:
            self._up = False
        return None

    def _watch(self, child: Child) -> None:
        """Raises ChildFailedError when the process is to be given up."""
        answered_s, patience_s = time.monotonic(), self._start_s
        while not self._stop.wait(LOOK_S):
            child.check()
            child.shorten_log()
            silent_s = time.monotonic() - answered_s
            if self._ready(child):
                self._is_up()
                answered_s, patience_s = time.monotonic(), HOPELESS_S
            elif silent_s > patience_s:
                raise ChildFailedError(f"the {child.name} has not answered for {silent_s:.0f} s; see {child.log}")
            elif self._up and silent_s > SILENT_S:
                self._is_down(f"the {child.name} does not answer; see {child.log}")

    def _is_up(self) -> None:
        if self._told and self._child:
            self._tell({"event": "up", "what": self._child.name})
        self._up, self._told = True, ""
        self._settled.set()

    def _is_down(self, reason: str) -> None:
        """Said once, and again where the reason is another."""
        self._up = False
        if reason != self._told and self._child:
            self._tell({"event": "down", "what": self._child.name, "reason": reason})
        self._told = reason
        self._settled.set()
