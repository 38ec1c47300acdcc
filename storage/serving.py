"""The artifact store on Zenoh (CONTRACT, section 1): trees on request, and an event for every change."""

from __future__ import annotations

import json
import logging
import threading
from types import TracebackType
from typing import Any, Final, Self

import zenoh

from learner.errors import LearnerError
from learner.model import check_alias
from storage.artifacts import ArtifactStore, Change
from storage.client import PREFIX
from storage.errors import DamagedError, DoubtfulError, NotStoredError, StorageError

POLL_S: Final = 0.25
"""How often the database is asked for changes, which any process may have made [s]."""
KNOWN: Final = ("version", "alias")
"""The parameters of a request."""
LOG: Final = logging.getLogger(__name__)


class BadQueryError(StorageError):
    """A request whose parameters cannot be understood."""


class StoreOnZenoh:
    """Serves `store` on `session` while the context is open.

    `treewright/artifacts/<task>` with `?version=7` or `?alias=production` (without either: production if set, else
    latest) answers with the XML and, as attachment, the manifest; a key with wildcards answers for every task that it
    matches. What cannot be answered is an error reply `{"error": sentence}`. Changes, by whichever process, are
    published on `treewright/artifacts/<task>/events` as `{"stamp_ns", "event", "task", "version", "alias", "digest"}`
    with `event` `published`, `alias` or `unalias`, in their order. The manifest comes with what is doubted of the
    version now, `doubtful`, and who `approved` it.
    """

    def __init__(self, session: zenoh.Session, store: ArtifactStore, poll_s: float = POLL_S) -> None:
        self._session, self._store, self._poll_s = session, store, poll_s
        self._stopped = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="artifact events", daemon=True)
        self._announced = 0

    def __enter__(self) -> Self:
        self._announced = self._store.last_change()
        self._queryable = self._session.declare_queryable(f"{PREFIX}/*", self._answer)
        self._watcher.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopped.set()
        self._watcher.join()
        self._queryable.undeclare()  # type: ignore[no-untyped-call]  # zenoh leaves its return type out

    def _answer(self, query: zenoh.Query) -> None:
        try:
            ref, key = _reference(query.parameters), str(query.key_expr)
            if "*" in key or "$" in key:
                self._reply_all(query, ref)
            else:
                self._reply(query, key.removeprefix(f"{PREFIX}/"), ref)
        except (StorageError, LearnerError) as error:
            _refuse(query, str(error))
        except Exception as error:  # an empty reply would tell the asker nothing
            LOG.exception("cannot answer %s", query.selector)
            _refuse(query, f"a defect in the artifact store: {type(error).__name__}: {error}")

    def _asked(self, key: zenoh.KeyExpr) -> list[str]:
        tasks = [row["task"] for row in self._store.tasks()]
        return [task for task in tasks if key.intersects(zenoh.KeyExpr(f"{PREFIX}/{task}"))]

    def _reply_all(self, query: zenoh.Query, ref: str | int | None) -> None:
        """Of many tasks those answer that have the version or alias; what is damaged of one keeps no other back."""
        for task in self._asked(query.key_expr):
            try:
                self._reply(query, task, ref)
            except (NotStoredError, DoubtfulError):
                continue
            except DamagedError as error:
                _refuse(query, str(error))

    def _reply(self, query: zenoh.Query, task: str, ref: str | int | None) -> None:
        artifact = self._store.get(task, ref)
        query.reply(
            f"{PREFIX}/{artifact.task}",
            artifact.xml,
            encoding=zenoh.Encoding.APPLICATION_XML,
            attachment=artifact.served_json,
        )

    def _watch(self) -> None:
        while not self._stopped.wait(self._poll_s):
            try:
                for change in self._store.changes(after=self._announced):
                    self._announce(change)
                    self._announced = change.serial
            except StorageError as error:
                LOG.warning("changes of the artifact store are announced later: %s", error)

    def _announce(self, change: Change) -> None:
        event = {name: value for name, value in vars(change).items() if name != "serial"}
        payload = json.dumps(event, sort_keys=True)
        self._session.put(f"{PREFIX}/{change.task}/events", payload, encoding=zenoh.Encoding.APPLICATION_JSON)


def _reference(parameters: zenoh.Parameters) -> str | int | None:
    if unknown := [name for name in _names(parameters) if name not in KNOWN]:
        raise BadQueryError(f"no parameter {unknown[0][:80]!r}; there are {' and '.join(KNOWN)}")
    version, alias = parameters.get("version"), parameters.get("alias")
    if version is not None and alias is not None:
        raise BadQueryError("ask for a version or for an alias, not for both")
    if version is not None and not (version.isascii() and version.isdigit()):
        raise BadQueryError(f"a version is a number, not {version[:80]!r}")
    return version if alias is None else check_alias(alias)


def _names(parameters: zenoh.Parameters) -> list[str]:
    """The names of all parameters of a selector; those that Zenoh itself gives a meaning begin with `_`."""
    parts = (part.partition("=")[0] for part in str(parameters).split(";") if part)
    return [name for name in parts if not name.startswith("_")]


def _refuse(query: zenoh.Query, sentence: str) -> None:
    document: dict[str, Any] = {"error": " ".join(sentence.split())}
    query.reply_err(json.dumps(document), encoding=zenoh.Encoding.APPLICATION_JSON)
