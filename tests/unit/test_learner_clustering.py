"""Clusters in a candidate frame, their score, and the evidence for a frame (paper, section III-E)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from learner.inference.clustering import clusters_in_frame, greatest_distance, of_members, score
from learner.inference.dbscan import FEW, dbscan
from learner.inference.frames import log_density, posterior
from learner.model.pose import Array, rotate

NUMBERS = st.floats(-1, 1)
POINTS = arrays(np.float64, st.tuples(st.integers(2, 8), st.just(3)), elements=NUMBERS)
SHIFT, TURN = np.array([0.3, -0.2, 0.1]), np.array([0.0, 0.0, math.sin(0.4), math.cos(0.4)])


@given(POINTS)
def test_a_rigid_change_of_frame_changes_neither_score_nor_density(points: Array) -> None:
    moved = rotate(TURN, points) + SHIFT
    assert greatest_distance(moved) == pytest.approx(greatest_distance(points), abs=1e-9)
    assert log_density(moved, 0.005, 2.0) == pytest.approx(log_density(points, 0.005, 2.0), abs=1e-6)


@given(POINTS.filter(lambda points: greatest_distance(points) > 1e-3), st.floats(1.1, 5))
def test_a_denser_cluster_scores_higher(points: Array, factor: float) -> None:
    assert score(points) == pytest.approx(score(points * factor) * factor)
    assert log_density(points, 0.005, 2.0) > log_density(points * factor, 0.005, 2.0)


@given(POINTS.filter(lambda points: greatest_distance(points) > 1e-3))
def test_the_same_points_twice_score_twice_as_high(points: Array) -> None:
    assert score(np.concatenate([points, points])) == pytest.approx(2 * score(points))


@given(POINTS, st.randoms(use_true_random=False))
def test_the_order_of_the_points_does_not_matter(points: Array, random: object) -> None:
    order = np.random.default_rng(7).permutation(len(points))
    assert score(points[order]) == pytest.approx(score(points))


def test_one_point_is_no_cluster() -> None:
    assert score(np.zeros((1, 3))) == -math.inf
    assert score(np.zeros((1, 3)), floor_m=0.003) == -math.inf


def test_the_score_is_size_over_greatest_distance_to_the_mean() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]])
    assert score(points) == pytest.approx(2 / 0.01)
    assert score(points, floor_m=0.01) == pytest.approx(2 / 0.02)


def test_points_that_coincide_score_without_bound_unless_there_is_a_floor() -> None:
    assert score(np.zeros((3, 3))) == math.inf
    assert score(np.zeros((3, 3)), floor_m=0.003) == pytest.approx(1000)


@pytest.mark.parametrize(("count", "min_samples", "clustered"), [(2, 3, False), (3, 3, True), (3, 4, False)])
def test_a_cluster_needs_its_least_number_of_samples(count: int, min_samples: int, clustered: bool) -> None:
    labels = dbscan(np.full((count, 3), 0.1), 0.03, min_samples)
    assert list(labels) == [0 if clustered else -1] * count


def test_no_points_make_no_cluster() -> None:
    empty = np.empty((0, 3))
    assert list(dbscan(empty, 0.03, 3)) == []
    assert clusters_in_frame("base", np.empty(0, dtype=np.intp), empty, dbscan(empty, 0.03, 3)) == []


def test_two_places_are_two_clusters_and_what_lies_alone_is_in_none() -> None:
    here = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0]])
    points = np.concatenate([here, [[0.5, 0.5, 0.5]], here + 0.1])
    samples = np.array([10, 11, 12, 13, 14, 15, 16])
    first, second = clusters_in_frame("box", samples, points, dbscan(points, 0.03, 3))
    assert (first.members, second.members) == ((10, 11, 12), (14, 15, 16))
    assert first.frame == second.frame == "box"
    assert np.allclose(second.mean, np.array(first.mean) + 0.1)
    assert first.score == pytest.approx(second.score) == pytest.approx(score(here))
    assert first.radius == pytest.approx(greatest_distance(here))


@given(POINTS)
def test_a_cluster_of_given_members_reaches_around_all_of_them(points: Array) -> None:
    cluster = of_members("base", np.arange(len(points)), points)
    distances = np.linalg.norm(points - np.array(cluster.mean), axis=1)
    assert distances.max() == pytest.approx(cluster.radius)
    assert cluster.members == tuple(range(len(points)))


LOGS = st.dictionaries(st.sampled_from("abcd"), st.floats(-500, 500), min_size=1)


@given(LOGS)
def test_probabilities_add_up_and_come_likeliest_first(logs: dict[str, float]) -> None:
    shares = posterior(logs, dict.fromkeys(logs, 1.0))
    assert sum(shares.values()) == pytest.approx(1.0)
    assert list(shares.values()) == sorted(shares.values(), reverse=True)
    assert set(shares) == set(logs)


@given(LOGS, st.floats(-100, 100))
def test_a_constant_in_every_density_changes_nothing(logs: dict[str, float], constant: float) -> None:
    odds = dict.fromkeys(logs, 1.0)
    shifted = posterior({name: log + constant for name, log in logs.items()}, odds)
    assert shifted == pytest.approx(posterior(logs, odds), abs=1e-9)


def test_frames_that_scatter_alike_are_equally_likely_and_odds_tip_them() -> None:
    assert posterior({"a": -3.0, "b": -3.0}, {"a": 1.0, "b": 1.0}) == pytest.approx({"a": 0.5, "b": 0.5})
    assert posterior({"a": -3.0, "b": -3.0}, {"a": 1.0, "b": 3.0}) == pytest.approx({"b": 0.75, "a": 0.25})


def test_ties_are_broken_by_name_so_that_the_result_is_always_the_same() -> None:
    assert list(posterior({"b": 0.0, "a": 0.0}, {"a": 1.0, "b": 1.0})) == ["a", "b"]


# The labels of DBSCAN


def blobs(rng: np.random.Generator, count: int) -> Array:
    """Dense and loose blobs, a sheet, and strays, in any order."""
    parts = [rng.normal(rng.uniform(-0.3, 0.3, 3), rng.choice([0.002, 0.01, 0.03]), (count // 4, 3)) for _ in range(3)]
    sheet = rng.uniform(-0.3, 0.3, (count - 3 * (count // 4), 3)) * [1, 1, 0]
    return np.asarray(rng.permutation(np.concatenate([*parts, sheet])))


@pytest.mark.parametrize("seed", range(24))
def test_labels_are_those_of_scikit_learn(seed: int) -> None:
    from sklearn.cluster import DBSCAN

    rng = np.random.default_rng(seed)
    points = blobs(rng, int(rng.integers(FEW // 4, 3 * FEW)))
    eps_m, least = float(rng.choice([0.01, 0.03, 0.08])), int(rng.choice([1, 3, len(points) // 10, len(points) // 4]))
    theirs = DBSCAN(eps=eps_m, min_samples=least, algorithm="kd_tree").fit(points).labels_
    assert np.array_equal(dbscan(points, eps_m, least), theirs)


@pytest.mark.parametrize("count", [FEW // 2, 2 * FEW])
def test_points_exactly_eps_apart_are_neighbours(count: int) -> None:
    chain = np.zeros((count, 3))
    chain[:, 0] = np.arange(count) / 64
    assert set(dbscan(chain, 1 / 64, 3).tolist()) == {0}
    assert set(dbscan(chain, 1 / 65, 2).tolist()) == {-1}


@pytest.mark.parametrize("count", [FEW // 2, 2 * FEW])
def test_points_that_coincide_are_one_cluster_wherever_the_others_lie(count: int) -> None:
    points = np.concatenate([np.zeros((count, 3)), [[1e6, 0.0, 0.0], [0.0, -1e6, 1e6]]])
    assert dbscan(points, 0.03, 3).tolist() == [0] * count + [-1, -1]


def test_a_border_point_belongs_to_the_first_cluster_that_reaches_it() -> None:
    left, right = np.zeros((FEW, 3)), np.tile([0.05, 0.0, 0.0], (FEW, 1))
    between = [[0.025, 0.0, 0.0]]
    assert dbscan(np.concatenate([right, between, left]), 0.03, FEW + 1)[FEW] == 0
    labels = dbscan(np.concatenate([between, left, right]), 0.03, FEW)
    assert set(labels.tolist()) == {0}, "a point that is core itself joins both"
