"""Learning a task of which something changed, once at a time, with what came of it remembered."""

from __future__ import annotations

from collections.abc import Callable

from learner.errors import LearnerError
from pipelines.errors import CommandError, UnreachableError
from pipelines.home import Home
from pipelines.steps.changes import changed_tasks, remember
from pipelines.steps.learn import Publication, learning
from pipelines.steps.stores import open_lake

NOTHING_CHANGED = "nothing changed since it was learned"


def relearn(home: Home, task: str, learn: Callable[[], Publication]) -> str:
    """What came of it, in a sentence; a task that somebody learns already is waited for.

    What will not pass is remembered until the task's demonstrations change; what may, is raised.
    """
    with learning(home, task):
        standing = changed_tasks(home, open_lake(home)).get(task)
        if standing is None:
            return NOTHING_CHANGED
        try:
            publication = learn()
            result = f"version {publication.version}, {publication.nodes} nodes"
        except UnreachableError:
            raise
        except (LearnerError, CommandError) as error:
            result = f"nothing learned: {error}"
        remember(home, task, standing.with_result(result))
        return result
