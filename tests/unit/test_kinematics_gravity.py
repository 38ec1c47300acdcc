"""Laws of resting bodies."""

from __future__ import annotations

import math

import numpy as np
import pytest

from learner.model import ObjectShape
from learner.model.upright import Spot
from learner.simulation.gravity import Body, Table

CUBE = Body(ObjectShape((0.05, 0.05, 0.05), "cube"))
BOX = Body(ObjectShape((0.3, 0.3, 0.08), "box"), "open_box")


def table(seed: int = 0, **spots: Spot) -> Table:
    bodies = {name: BOX if name.startswith("box") else CUBE for name in spots}
    return Table(bodies, spots, np.random.default_rng(seed))


def at(x: float, y: float, z: float = 0.025, yaw: float = 0.0) -> Spot:
    return Spot(x, y, z, yaw)


def test_a_spot_composed_with_its_relative_is_the_other_spot() -> None:
    a, b = at(0.3, 0.1, 0.2, 2.0), at(-0.1, 0.4, 0.0, -1.0)
    back = a.compose(a.relative(b))
    assert (back.x, back.y, back.z, back.yaw) == pytest.approx((b.x, b.y, b.z, b.yaw))


def test_a_spot_agrees_with_its_pose() -> None:
    a, b = at(0.3, 0.1, 0.2, 2.0), at(-0.1, 0.4, 0.0, -1.0)
    assert (a.pose() @ b.pose()).position == pytest.approx(a.compose(b).pose().position)
    assert Spot.of(a.pose()).yaw == pytest.approx(2.0)


def test_a_cube_laid_over_another_stands_on_it() -> None:
    world = table(A=at(0.4, 0.0), B=at(0.6, 0.3))
    world.lay("B", at(0.41, 0.01, yaw=0.5))
    assert world.spots["B"].z == pytest.approx(0.075)
    assert world.on("A") == {"B"}
    assert world.covered("A")
    assert not world.covered("B")


@pytest.mark.parametrize("seed", range(10))
def test_a_cube_whose_centre_is_not_carried_falls_beside(seed: int) -> None:
    angle = np.random.default_rng(seed).uniform(-math.pi, math.pi)
    world = table(seed, A=at(0.4, 0.0), B=at(0.6, 0.3))
    world.lay("B", at(0.4 + 0.038 * math.cos(angle), 0.038 * math.sin(angle)))
    assert world.spots["B"].z == pytest.approx(0.025)
    assert not world.footprint("B").overlaps(world.footprint("A"), 0.005)


def test_a_cube_across_a_gap_stands_on_both_sides() -> None:
    world = table(A=at(0.4, 0.0), B=at(0.4, 0.07), C=at(0.8, 0.3))
    world.lay("C", at(0.4, 0.035))
    assert world.spots["C"].z == pytest.approx(0.075)
    assert world.on("A") == world.on("B") == {"C"}


def test_a_box_carries_its_content_wherever_it_goes() -> None:
    world = table(box=at(0.5, 0.0, 0.04), A=at(0.55, 0.05, 0.03), B=at(0.55, 0.05, 0.08), C=at(0.2, 0.5))
    before = {name: world.spots["box"].relative(world.spots[name]) for name in "AB"}
    world.carry("box", at(0.4, -0.3, 0.04, 2.0))
    for name, spot in before.items():
        assert world.spots["box"].relative(world.spots[name]).x == pytest.approx(spot.x)
    assert world.spots["C"] == at(0.2, 0.5)


def test_what_stood_on_a_cube_falls_when_it_is_pulled_out() -> None:
    world = table(A=at(0.4, 0.0), B=at(0.4, 0.0, 0.075), C=at(0.4, 0.0, 0.125))
    world.lay("A", at(0.8, 0.4))
    assert world.spots["B"].z == pytest.approx(0.025)
    assert world.spots["C"].z == pytest.approx(0.075)


@pytest.mark.parametrize("seed", range(20))
def test_a_cube_dropped_over_a_box_comes_to_rest_inside(seed: int) -> None:
    world = table(seed, box=at(0.5, 0.0, 0.04, 0.7), A=at(0.8, 0.4))
    world.drop("A", at(0.5, 0.0, 0.14))
    inside = world.spots["box"].relative(world.spots["A"])
    assert max(abs(inside.x), abs(inside.y)) < 0.125
    assert world.spots["A"].z == pytest.approx(0.03)


def test_a_drop_from_far_above_a_cube_often_ends_beside_it() -> None:
    ends = []
    for seed in range(60):
        world = table(seed, A=at(0.4, 0.0), B=at(0.8, 0.4))
        world.drop("B", at(0.4, 0.0, 0.2))
        ends.append(world.spots["B"].z > 0.05)
    assert 5 < sum(ends) < 58
