"""A cell's conditions, answered for engines that are not ours (CONTRACT, section 3): a leaf is then ten lines anywhere.

Ports come as JSON on `treewright/<cell>/conditions/<node>`, and `{"status", ...}` goes back, with the out ports where a
query has found something. Zenoh's threads only queue; what is asked is answered between two looks at the cell, so that
an answer is of one moment.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Final, Self

import zenoh

from learner.errors import ModelError, TreeError
from learner.execution.perception import condition_of, query_of
from learner.model.tree import Definition, Node, Tree, Value
from learner.model.vocabulary import CONDITIONS, LENGTHS, QUERIES, outputs_of
from pipelines.controller.cell_link import CellLink

PERIOD_S: Final = 0.01
"""Between two looks for what was asked [s]."""
MOST_WAITING: Final = 1000
"""So many questions wait to be answered; of more the oldest go unanswered."""
OPTIONAL: Final = {"at": "", "not_at": ""}


class World:
    """The queryables of one cell's conditions; open within a `with` block. The link must be open."""

    def __init__(self, session: zenoh.Session, link: CellLink) -> None:
        self._session, self._link = session, link
        self._asked: deque[zenoh.Query] = deque(maxlen=MOST_WAITING)
        self._root = f"treewright/{link.cell}/conditions"

    def __enter__(self) -> Self:
        self._queryable = self._session.declare_queryable(f"{self._root}/*", self._asked.append)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._queryable.undeclare()  # type: ignore[no-untyped-call]  # zenoh leaves its return type out

    def run(self, stop: threading.Event) -> None:
        """Answer until `stop` is set."""
        self._link.take_in()
        self._link.state.begin()
        while not stop.wait(PERIOD_S):
            self._link.take_in()
            while self._asked:
                self._answer(self._asked.popleft())

    def _answer(self, query: zenoh.Query) -> None:
        kind = str(query.key_expr).rpartition("/")[2]
        with query:
            try:
                payload = b"{}" if query.payload is None else bytes(query.payload)
                answer = self.answer(kind, payload)
            except (TreeError, ModelError) as error:
                sentence = json.dumps({"error": " ".join(str(error).split())})
                query.reply_err(sentence, encoding="application/json")
                return
            query.reply(f"{self._root}/{kind}", json.dumps(answer), encoding="application/json")

    def answer(self, kind: str, payload: bytes) -> dict[str, Any]:
        """The answer to a condition with ports in JSON. Raises TreeError or ModelError for what is none."""
        node, state = _asked(kind, payload), self._link.state
        if kind not in QUERIES:
            return _told(state.holds(condition_of(node)))
        found = state.find(query_of(node))
        return {**_told(found is not None), **{port: _to_json(value) for port, value in (found or {}).items()}}


def _told(holds: bool) -> dict[str, Any]:
    return {"status": "success" if holds else "failure"}


def _to_json(value: Value) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _asked(kind: str, payload: bytes) -> Node:
    """The leaf that is asked. Raises TreeError for a node that is no condition, and for ports that are not its own."""
    if kind not in CONDITIONS:
        raise TreeError(f"{kind!r} is no condition of the contract; there are {', '.join(CONDITIONS)}")
    try:
        fields = json.loads(payload or b"{}")
    except (ValueError, RecursionError) as error:
        raise TreeError(f"the ports of {kind} are no JSON: {error}") from error
    if not isinstance(fields, Mapping):
        raise TreeError(f"the ports of {kind} are a JSON object")
    optional = {port: value for port, value in OPTIONAL.items() if port in CONDITIONS[kind]}
    read = {port: _of_json(kind, port, value) for port, value in {**optional, **fields}.items()}
    ports = {**read, **{port: f"{{{port}}}" for port in outputs_of(kind)}}
    return Tree(Definition("Asked", Node(kind, tuple(sorted(ports.items()))))).main.root


def _of_json(kind: str, port: str, value: Any) -> Value:
    """A port's value as a tree has it: numbers, or the text that a tree would hold."""
    try:
        if port in LENGTHS:
            numbers = value.split(";") if isinstance(value, str) else value
            return tuple(map(float, numbers))
        if port in ("radius", "angle"):
            return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise TreeError(f"{kind} cannot have {port} = {value!r:.80}") from error
    if isinstance(value, str):
        return value
    if port in ("count", "value") and isinstance(value, bool | int | float):
        return json.dumps(value)
    raise TreeError(f"{kind} cannot have {port} = {value!r:.80}")
