"""What a run on the cell tells of itself, and a run that the panel begins and ends (pipelines.controller.progress)."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.network.question import ask
from pipelines.service.child import Child, ChildFailedError

if TYPE_CHECKING:
    import zenoh

STOP_S: Final = 2.0
"""Patience with a run that is asked to end [s]; it answers at once."""
RUN_S: Final = 1e8
"""A run takes as long as it takes [s]."""


@dataclass(frozen=True)
class RunState:
    """What was last told of a run: `told` is the newest document, `nodes` every node's status by its index.

    `busy` is whether one is on its way or under way; `sentence` is why the last one that was begun here failed.
    """

    told: Mapping[str, Any] = field(default_factory=dict)
    nodes: Mapping[int, str] = field(default_factory=dict)
    busy: bool = False
    sentence: str = ""


class RunWatch:
    """Hears the runs of a cell from entering to leaving its context, begins one and ends any.

    `command` are the words behind `treewright run` that lead to the cell's network and store. Leaving ends a run that
    was begun here.
    """

    def __init__(self, session: zenoh.Session, cell: str, command: Sequence[str], home: Home) -> None:
        self._session, self._root, self._log = session, f"treewright/{cell}/run", home.logs / "run.log"
        self._environment = {**os.environ, "TREEWRIGHT_HOME": str(home.root)}
        self._command = ["--cell", cell, *command]
        self._lock = threading.Lock()
        self._told: Mapping[str, Any] = {}
        self._nodes: dict[int, str] = {}
        self._sentence = ""
        self._stopped = False
        self._child: Child | None = None
        self._thread: threading.Thread | None = None
        self._open = ExitStack()

    def __enter__(self) -> Self:
        self._open.enter_context(self._session.declare_subscriber(f"{self._root}/status", self._receive))
        for reply in self._session.get(f"{self._root}/now", timeout=STOP_S):
            if reply.ok is not None:
                self._take(reply.ok.payload.to_bytes())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()
        if self._child is not None:
            self._child.end()
        if self._thread is not None:
            self._thread.join()

    def now(self) -> RunState:
        """What is known at this moment."""
        with self._lock:
            under_way = bool(self._told) and self._told["outcome"] is None
            return RunState(self._told, dict(self._nodes), under_way or self._child is not None, self._sentence)

    def start(self, tree: str, watch: bool) -> None:
        """Begin a run of a tree, as `treewright run` does; with `watch` it goes on after success.

        Raises CommandError if one is under way.
        """
        with self._lock:
            if self._child is not None:
                raise CommandError("a run that was begun here is under way; stop it first")
            words = [sys.executable, "-m", "pipelines.cli", "run", tree, "--json", *self._command]
            words += ["--watch"] if watch else []
            self._child = Child("run", words, self._environment, self._log, speaks_json=True)
            self._sentence, self._stopped = "", False
        begun = threading.Event()
        self._thread = threading.Thread(target=self._live, args=(self._child, begun), name="panel-run", daemon=True)
        self._thread.start()
        begun.wait()

    def stop(self) -> None:
        """End the run that is under way on the cell, whoever began it. Raises CommandError if there is none."""
        with self._lock:
            child, self._stopped = self._child, True
        if child is not None:
            child.end()
        else:
            ask(self._session, f"{self._root}/stop", {}, STOP_S)

    def _live(self, child: Child, begun: threading.Event) -> None:
        """One run from its start to its end, in a thread of its own: a process ends with the thread that began it."""
        try:
            with child:
                begun.set()
                sentence = _sentence(_end_of(child))
        except ChildFailedError as error:
            sentence = "" if self._stopped else str(error)
        finally:
            begun.set()
        with self._lock:
            self._sentence, self._child = sentence, None
            if self._told and self._told["outcome"] is None:
                self._told = {**self._told, "outcome": "lost", "action": None}

    def _receive(self, sample: zenoh.Sample) -> None:
        """What is no document of a run is told, and changes nothing else."""
        try:
            self._take(bytes(sample.payload))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            self._sentence = f"a message on {sample.key_expr} is none of a run: {type(error).__name__}: {error}"

    def _take(self, payload: bytes) -> None:
        """A change; of another run than before everything is new."""
        document = json.loads(payload)
        with self._lock:
            if self._told.get("outcome") or self._told.get("digest") != document["digest"]:
                self._nodes.clear()
            for index, status in document["nodes"].items():
                if status is None:
                    self._nodes.pop(int(index), None)
                else:
                    self._nodes[int(index)] = status
            self._told = document


def _end_of(child: Child) -> Mapping[str, Any]:
    """What a run says at its end. Raises ChildFailedError where it ends without."""
    said = child.hear(RUN_S)
    while "outcome" not in said:
        said = child.hear(RUN_S)
    return said


def _sentence(ended: Mapping[str, Any]) -> str:
    """Why a run did not reach its goal; nothing where it did, or was stopped."""
    return "" if ended["outcome"] in ("success", "stopped") else str(ended["reason"])
