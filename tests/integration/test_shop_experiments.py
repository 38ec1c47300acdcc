"""The shop's tasks: what the demonstrator does is done by the truth, and what fails in silence is told as such."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from experiments.shop import ShopCell, compute_shop, is_silently_wrong, run_shop, shop_table, shown
from experiments.shop_tasks import SHOP, Course, is_possible, start_of

from learner.learning import learn
from learner.model import Demonstration, Pose
from learner.planning.draft import Draft
from learner.simulation.gravity import Spot


def course_of(demonstration: Demonstration) -> Course:
    """What was seen of it."""
    rested = [(a.object, at(a.objects) | {a.object: Spot.of(a.rest["base"])}) for a in demonstration.actions if a.rest]
    return Course(at(demonstration.first_seen), at(demonstration.final), rested)


def at(poses: dict[str, Pose]) -> dict[str, Spot]:
    return {name: Spot.of(pose) for name, pose in poses.items()}


@pytest.mark.parametrize("name", SHOP)
def test_what_the_demonstrator_does_is_done_by_the_truth_and_was_not_before(name: str) -> None:
    (demonstration,) = shown(SHOP[name], 1, 5)
    course = course_of(demonstration)
    assert SHOP[name].done(course)
    assert not SHOP[name].done(Course(course.start, course.start))


@pytest.mark.parametrize("name", ["screws", "lid"])
def test_a_start_has_everything_on_its_place_and_a_script_that_leaves_the_table_is_not_possible(name: str) -> None:
    task, rng = SHOP[name], np.random.default_rng(1)
    start = start_of(task, rng, strangers=True)
    assert set(start) == {*task.objects, *task.strangers}
    first, *others = task.script({n: start[n] for n in task.objects}, rng)
    far = (type(first)(first.type, first.object, "base", (3.0, 0.0, 0.1)), *others)
    assert not is_possible(task, {n: start[n] for n in task.objects}, far)


def test_a_tree_that_works_and_one_that_skips_a_station_are_told_apart() -> None:
    corner, station = (compute_shop(ShopCell(name, 3, 0, rehearsed=False, runs=3)) for name in ("corner", "station"))
    assert (corner["calm"], station["calm"]) == ({"done": 3}, {"done": 3})
    assert (corner["doubts"], station["doubts"]) == ([], [])
    wrong = {**station, "calm": skipping_the_station()}
    doubted = {**wrong, "doubts": ["visit"]}
    assert [is_silently_wrong(each) for each in (corner, station, doubted, wrong)] == [False, False, False, True]
    told = shop_table([corner, wrong])
    assert "| corner | an orientation of the base | 3 | 3 of 3 |" in told
    assert "- station, 3 demonstrations, set 0: {'false success': 3}" in told


def skipping_the_station() -> Counter[str]:
    """The verdicts on a tree that brings the part where it belongs, past the station."""
    learned = learn(shown(SHOP["station"], 3, 0))
    assert learned.draft
    groups = [replace(group, subgoals=tuple(replace(s, stops=()) for s in group.subgoals))
              for group in learned.draft.understood.groups]  # fmt: skip
    tree = Draft(replace(learned.draft.understood, groups=tuple(groups)), learned.draft.parameters, {}).tree()
    rngs = (np.random.default_rng([7, number]) for number in range(3))
    return Counter(run_shop(SHOP["station"], tree.flattened(), rng, grasps=learned.grasps) for rng in rngs)
