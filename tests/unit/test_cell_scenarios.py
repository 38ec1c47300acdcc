"""Scenarios are data: their starts keep clear of each other and of the goal, their goals hold when reached."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from learner.model import Pose
from learner.simulation.cell.camera import Camera, Noise
from learner.simulation.scenarios import (
    BASE,
    REACH_M,
    SCENARIOS,
    UnknownScenarioError,
    sample_spot,
    sample_start,
    scenario_named,
)

SEEDS = range(12)


def _after(name: str, start: dict[str, Pose]) -> dict[str, Pose]:
    """Where the steps of a scenario would leave everything, were they done exactly."""
    poses = dict(start)
    for step in SCENARIOS[name].steps:
        frame = Pose((0.0, 0.0, 0.0)) if step.frame == BASE else poses[step.frame]
        lower = -0.07 if step.type == "drop" else 0.0
        x, y, z = frame.apply(step.at)
        poses[step.object] = Pose((x, y, z + lower), frame.quaternion_xyzw)
    return poses


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_start_is_not_the_goal_and_the_steps_lead_to_it(name: str) -> None:
    for seed in SEEDS:
        start = sample_start(SCENARIOS[name], np.random.default_rng(seed))

        assert set(start) == set(SCENARIOS[name].objects)
        assert not SCENARIOS[name].reached(start)
        assert SCENARIOS[name].reached(_after(name, start))


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_order_does_every_step_once(name: str) -> None:
    for order in SCENARIOS[name].step_orders():
        assert sorted(order) == list(range(len(SCENARIOS[name].steps)))


@pytest.mark.parametrize("name", ["object_in_box", "towers", "tower_and_box", "kitting"])
def test_cubes_start_in_reach_and_apart(name: str) -> None:
    for seed in SEEDS:
        start = sample_start(SCENARIOS[name], np.random.default_rng(seed))
        cubes = [pose for each, pose in start.items() if SCENARIOS[name].bodies[each].graspable]
        for cube in cubes:
            assert REACH_M[0] <= math.hypot(*cube.position[:2]) <= REACH_M[1]
        for one, other in itertools.combinations(cubes, 2):
            assert math.dist(one.position, other.position) >= 0.10


def test_the_same_seed_gives_the_same_start_and_another_seed_another() -> None:
    scenario = SCENARIOS["tower_and_box"]
    first, again, other = (sample_start(scenario, np.random.default_rng(seed)) for seed in (1, 1, 2))

    assert first == again
    assert first != other


def test_a_free_spot_keeps_clear_of_what_stands_there() -> None:
    scenario, rng = SCENARIOS["object_in_box"], np.random.default_rng(0)
    start = sample_start(scenario, rng)
    for _ in range(20):
        spot = sample_spot(scenario, "A", {"box": start["box"]}, rng)
        x, y, _ = start["box"].inverse().apply(spot.position)
        assert max(abs(x), abs(y)) > 0.15


def test_an_unknown_scenario_is_refused_by_a_sentence_that_names_those_there_are() -> None:
    with pytest.raises(UnknownScenarioError, match=r"no scenario 'juggling'; there are object_in_box, towers"):
        scenario_named("juggling")


def test_the_camera_has_the_noise_that_it_is_given() -> None:
    true, camera = {"A": Pose((0.5, 0.1, 0.025))}, Camera(Noise(0.002, 0.01), np.random.default_rng(0))
    seen = np.array([camera.observe(true)["A"].position for _ in range(800)])

    assert seen.mean(axis=0) == pytest.approx(true["A"].position, abs=3e-4)
    assert seen.std(axis=0) == pytest.approx([0.002] * 3, rel=0.15)


def test_an_estimate_is_steadier_than_a_look_and_follows_an_object_that_moved() -> None:
    before, after = {"A": Pose((0.5, 0.1, 0.025))}, {"A": Pose((0.6, -0.1, 0.025))}
    errors_of_looks, errors_of_estimates = [], []
    for seed in range(60):
        camera = Camera(Noise(0.003, 0.01), np.random.default_rng(seed))
        for _ in range(9):
            look = camera.observe(before)["A"]
        estimate = camera.estimate("A")
        assert estimate is not None
        errors_of_looks.append(math.dist(look.position, before["A"].position))
        errors_of_estimates.append(math.dist(estimate.position, before["A"].position))
        camera.observe(after)
        moved = camera.estimate("A")
        assert moved is not None
        assert math.dist(moved.position, after["A"].position) < 0.015
    assert np.mean(errors_of_estimates) < 0.5 * np.mean(errors_of_looks)


def test_an_object_never_seen_has_no_estimate() -> None:
    assert Camera(Noise(), np.random.default_rng(0)).estimate("A") is None
