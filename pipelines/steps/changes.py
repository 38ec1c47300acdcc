"""What was learned from what, so that the scheduled refresh learns only what changed since.

`learned.json` in the data root holds, by task, a digest of all that a tree follows from (the demonstrations with a
person's corrections, and the learner's code) and what came of learning from it.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

from learner.learning import DEFAULT_METHOD
from pipelines.home import Home
from pipelines.steps.learn import code_version
from pipelines.steps.locks import locked
from storage.lake import Lake, Word


@dataclass(frozen=True)
class TaskState:
    """Where a task stands: the `digest` of what its tree follows from, and the `result` of learning from it."""

    digest: str
    result: str = ""

    def with_result(self, result: str) -> TaskState:
        """The same input with what came of it."""
        return replace(self, result=result)


def changed_tasks(home: Home, lake: Lake) -> dict[str, TaskState]:
    """The tasks of the lake that were not yet learned as they stand now; results are still empty."""
    by_task: dict[str, list[Word]] = defaultdict(list)
    for word in lake.words():
        by_task[word.task].append(word)
    before = standings(home)
    now = {name: standing_of(by_task[name]) for name in sorted(by_task)}
    return {name: standing for name, standing in now.items() if _digest(before.get(name)) != standing.digest}


def standing_of(words: Iterable[Word]) -> TaskState:
    """The standing of one task's demonstrations, in whatever order they come."""
    facts = [sorted(map(_facts, words)), code_version(), DEFAULT_METHOD]
    return TaskState(hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest())


def standings(home: Home) -> dict[str, TaskState]:
    """What was learned so far; nothing where the file is missing or is not ours, for then all is learned again."""
    try:
        document = json.loads(home.learned.read_text())
        return {name: TaskState(entry["digest"], entry["result"]) for name, entry in document.items()}
    except (FileNotFoundError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def remember(home: Home, task: str, standing: TaskState) -> None:
    """Note what came of learning a task: written beside, renamed, by one process after the other."""
    with locked(home.lock("learned")):
        document = {name: asdict(entry) for name, entry in (standings(home) | {task: standing}).items()}
        beside = home.learned.with_name(f".{home.learned.name}.{secrets.token_hex(4)}.part")
        try:
            beside.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n")
            beside.replace(home.learned)
        finally:
            beside.unlink(missing_ok=True)


def _digest(standing: TaskState | None) -> str | None:
    return standing.digest if standing else None


def _facts(word: Word) -> list[Any]:
    return [word.demonstration_id, word.sha256, word.excluded, sorted(word.meant.items())]
