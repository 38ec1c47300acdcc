"""What a run tells of itself while it runs, below `treewright/<cell>/run/`, JSON, for whoever looks on:

    status   published on a change, at most ten times a second: {"stamp_ns", "tree", "digest", "tick", "status",
             "action", "failures": {action: n}, "reason", "outcome", "nodes": {index: status or null}}
    now      {} answers the same with every node that was ticked, for who comes later
    stop     {} ends the run as a signal does: {"stopping": true}

`nodes` are those that changed; an index is the node's place in the flattened tree, depth first, from 0. `action` is the
one under way. `reason` is the last failure's. `outcome` is null until the run has ended.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from types import TracebackType
from typing import Any, Final, Self

import zenoh

from learner.execution.ticking import Status

PERIOD_S: Final = 0.1
"""Time between two messages at least [s]."""
SHARE: Final = 0.05
"""Looking at a large tree's nodes takes no more of the time than this."""
JSON: Final = "application/json"
Nodes = Sequence[Status | None]


@dataclass(frozen=True)
class Moment:
    """A run at one moment, its nodes left out."""

    tick: int = 0
    status: str | None = None
    action: str | None = None
    failures: Mapping[str, int] = field(default_factory=dict)
    reason: str | None = None
    outcome: str | None = None


class Progress:
    """Tells of one run while the context is open; `stop` is set when somebody asks for its end."""

    def __init__(self, session: zenoh.Session, cell: str, tree: str, digest: str, stop: threading.Event) -> None:
        self._session, self._root, self._stop = session, f"treewright/{cell}/run", stop
        self._name = {"tree": tree, "digest": digest}
        self._lock = threading.Lock()
        self._moment, self._nodes = Moment(), tuple[Status | None, ...]()
        self._due_s = float("-inf")
        self._open = ExitStack()

    def __enter__(self) -> Self:
        enter = self._open.enter_context
        self._publisher = enter(self._session.declare_publisher(f"{self._root}/status", encoding=JSON))
        enter(self._session.declare_queryable(f"{self._root}/now", self._answer_now))
        enter(self._session.declare_queryable(f"{self._root}/stop", self._answer_stop))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._open.close()

    @property
    def due(self) -> bool:
        """Whether enough time has passed for another message."""
        return time.monotonic() >= self._due_s

    def tell(self, moment: Moment, nodes: Nodes, began_s: float) -> None:
        """Publish what has changed; `began_s` (time.monotonic) is when the looking began, which costs time too."""
        with self._lock:
            changed = _changed(self._nodes, nodes)
            told = bool(changed) or moment != self._moment
            self._moment, self._nodes = moment, tuple(nodes)
            if told:
                self._publisher.put(json.dumps(self._document(changed)))
        now_s = time.monotonic()
        self._due_s = began_s + max(PERIOD_S, (now_s - began_s) / SHARE)

    def end(self, outcome: str, reason: str, nodes: Nodes) -> None:
        """Tell how the run ended, and what the nodes were then."""
        self.tell(replace(self._moment, action=None, outcome=outcome, reason=reason), nodes, time.monotonic())

    def _document(self, nodes: Mapping[str, str | None]) -> dict[str, Any]:
        return {"stamp_ns": time.time_ns(), **self._name, **asdict(self._moment), "nodes": nodes}

    def _answer_now(self, query: zenoh.Query) -> None:
        with self._lock:
            document = self._document(_changed((), self._nodes))
        with query:
            query.reply(f"{self._root}/now", json.dumps(document), encoding=JSON)

    def _answer_stop(self, query: zenoh.Query) -> None:
        self._stop.set()
        with query:
            query.reply(f"{self._root}/stop", json.dumps({"stopping": True}), encoding=JSON)


def _changed(before: Nodes, after: Nodes) -> dict[str, str | None]:
    """The statuses that are not as they were, by index; before the first time none was ticked."""
    known = before or (None,) * len(after)
    return {
        str(index): new and new.value
        for index, (old, new) in enumerate(zip(known, after, strict=True))
        if old is not new
    }
