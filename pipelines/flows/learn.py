"""The flow that learns: choose demonstrations; cluster, infer, plan and verify; publish."""

from __future__ import annotations

from pathlib import Path

from prefect import flow, task

from learner.learned import Learned
from learner.learning import DEFAULT_METHOD
from pipelines.flows.patience import PATIENT
from pipelines.flows.shown import show_learned, show_publication
from pipelines.home import Home
from pipelines.steps.learn import Choice, Publication, choose, learn_from, learning, publish
from pipelines.steps.stores import open_lake, open_store


@flow(name="learn", validate_parameters=False)
def learn_flow(
    root: str,
    task_name: str,
    method: str = DEFAULT_METHOD,
    include_unknown: bool = False,
    include_gaps: bool = False,
) -> Publication:
    """Learn a task from the lake below the data root and publish its tree."""
    with learning(Home(Path(root)), task_name):
        choice = choose_demonstrations(root, task_name, include_unknown, include_gaps)
        learned = learn_tree(choice, method)
        show_learned(task_name, learned)
        publication = publish_tree(root, choice, learned, method)
        show_publication(publication, learned)
        return publication


@task(name="choose demonstrations", **PATIENT)
def choose_demonstrations(root: str, task_name: str, include_unknown: bool, include_gaps: bool) -> Choice:
    """Which demonstrations of the task are learned from."""
    return choose(open_lake(Home(Path(root))), task_name, include_unknown, include_gaps)


@task(name="cluster, infer, plan, verify")
def learn_tree(choice: Choice, method: str) -> Learned:
    """The learner's one call: the same demonstrations give the same tree."""
    return learn_from(choice, method)


@task(name="publish", **PATIENT)
def publish_tree(root: str, choice: Choice, learned: Learned, method: str) -> Publication:
    """A version in the store, and `latest`."""
    with open_store(Home(Path(root))) as store:
        return publish(store, choice, learned, method)
