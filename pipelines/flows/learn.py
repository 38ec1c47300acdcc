"""The flow that learns: choose demonstrations; cluster, infer, plan, rehearse, prove, replay; publish."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from prefect import flow

from learner.learning import DEFAULT_METHOD
from pipelines.flows.patience import PATIENT
from pipelines.flows.shown import show_learned, show_publication, show_timings
from pipelines.flows.stages import SeenStages
from pipelines.flows.tagged import tag_run
from pipelines.home import Home
from pipelines.steps.learn import Choice, Publication, choose, learn_from, learning, publish
from pipelines.steps.stores import open_lake, open_store


@flow(name="learn", flow_run_name="learn {task_name}", validate_parameters=False)
def learn_flow(
    root: str,
    task_name: str,
    method: str = DEFAULT_METHOD,
    include_unknown: bool = False,
    include_gaps: bool = False,
) -> Publication:
    """Learn a task from the lake below the data root and publish its tree."""
    home, stages = Home(Path(root)), SeenStages(task_name)
    with learning(home, task_name), open_store(home) as store:
        lake = open_lake(home)
        choice = stages.run("choose", lambda: choose(lake, task_name, include_unknown, include_gaps), **PATIENT)
        learned = learn_from(choice, method, stages=stages)
        publication = stages.run("publish", lambda: publish(store, choice, learned, method), **PATIENT)
    # The tree first: all that is shown of it can wait. Tasks get no tags, for Prefect asks for slots by each of them.
    stages.end_progress()
    tag_run(tags_of(choice))
    show_learned(publication, learned)
    show_publication(publication, learned)
    show_timings(publication, stages.seconds)
    return publication


def tags_of(choice: Choice) -> list[str]:
    """By what a run is found: its task, and the cells and users whose demonstrations it learns from."""
    return [
        f"task:{choice.task}",
        *_named("cell", (demonstration.cell for demonstration in choice.demonstrations)),
        *_named("user", (demonstration.user for demonstration in choice.demonstrations)),
    ]


def _named(what: str, names: Iterable[str]) -> list[str]:
    return [f"{what}:{name}" for name in sorted(set(names))]
