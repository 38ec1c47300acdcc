"""Failures are values: counted by what they are, told as sentences."""

from __future__ import annotations

import numpy as np
import pytest
from support_demonstrations import Put, repeated

from learner.learning import METHODS
from learner.model import ObjectAt, ObjectShape
from learner.model.upright import Spot
from learner.parameters import Parameters
from learner.rehearsal.goal import Goal
from learner.rehearsal.lessons import Lessons
from learner.rehearsal.rehearsal import RolloutResult
from learner.rehearsal.rollouts import Rollout
from learner.rehearsal.share import Share
from learner.simulation.arena import Aftermath
from learner.simulation.failure import Failure
from learner.simulation.gravity import Body
from learner.simulation.kinematic_world import Attempt, KinematicWorld

CUBE = Body(ObjectShape((0.05, 0.05, 0.05), "cube"))


def result(*failures: Failure | None) -> RolloutResult:
    """A rollout in which A was placed at B time and again."""
    bodies = {"A": CUBE, "B": CUBE}
    spots = {name: Spot(0.4, 0.1 * number, 0.025, 0.0) for number, name in enumerate(bodies)}
    world = KinematicWorld(bodies, spots, np.random.default_rng(0))
    world.attempts += [Attempt("Place", "A", "B", step, failure, ended=True) for step, failure in enumerate(failures)]
    return RolloutResult(Rollout("d1", spots), "no progress", Aftermath.of(world))


def test_six_equal_failures_under_noise_count_as_six() -> None:
    noisy = result(*(Failure("contact", with_="B", left_m=0.01 * left) for left in (4, 4, 4, 5, 5, 6)))
    assert list(noisy.failing.values()) == [6]
    assert str(noisy) == (
        "from the start of demonstration d1: no progress; Place A: contact with B 4.0 cm before the target (6 times)"
    )


def test_a_contact_that_happens_often_with_what_lies_where_it_belongs_tells_the_order() -> None:
    script = [Put("B", "base", (0.4, 0.1, 0.025)), Put("A", "B", (0.0, 0.0, 0.05))]
    draft = METHODS["treewright"](repeated(["A", "B"], [script] * 3), Parameters()).draft
    assert draft
    goal = Goal((ObjectAt("B", "base", (0.4, 0.1, 0.025), 0.05),))
    lessons = Lessons(draft.placements, draft.orders, [goal], dict.fromkeys("ABC", CUBE))
    met, other = ([Failure("contact", with_=name, left_m=0.01 * left) for left in range(3)] for name in "BC")
    (taught,) = lessons.of([result(*met)])
    assert {(a.object, b.object) for a, b in taught.before} == {("A", "B")}
    assert lessons.of([result(*met[:2])]) == []
    assert lessons.of([result(*other)]) == []


def test_failures_of_another_kind_or_with_another_thing_are_told_apart() -> None:
    failures = (Failure("contact", with_="B"), Failure("contact", with_="C"), Failure("missed", "A", "B"), None)
    assert sorted(result(*failures).failing.values()) == [1, 1, 1]


@pytest.mark.parametrize(
    ("failure", "sentence"),
    [
        (Failure("contact", with_="the table"), "contact with the table"),
        (Failure("contact", with_="B", left_m=0.04), "contact with B 4.0 cm before the target"),
        (Failure("missed", "A"), "A is not held: the fingers closed on nothing"),
        (Failure("missed", "A", "B"), "A is not held: the fingers closed on B"),
        (Failure("not held", "A"), "A is not held: the gripper holds nothing"),
        (Failure("lost", "A"), "A was lost on the way"),
        (Failure("out of reach", at=(1.0, 2.0, -0.5)), "the pose is out of reach: 1.000, 2.000, -0.500 m in the base"),
        (Failure("out of reach"), "the pose is out of reach"),
        (Failure("gripper closed", "A"), "the gripper is closed already"),
        (Failure("random"), "the skill failed"),
        (Failure("other", said="cancelled"), "cancelled"),
    ],
)
def test_a_failure_is_told_in_one_sentence(failure: Failure, sentence: str) -> None:
    assert str(failure) == sentence


def test_a_share_is_a_number_and_a_phrase() -> None:
    assert (float(Share(2, 4)), str(Share(2, 4)), float(Share(0, 0))) == (0.5, "2 of 4", 1.0)
