"""Clusters of positions in a candidate frame (paper, section III-E): DBSCAN, and the score of a cluster."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from learner.model.pose import Array


@dataclass(frozen=True)
class Cluster:
    """Samples that lie together in `frame`.

    `members` are sorted sample numbers; `mean` [m]: (3,); `radius` is the greatest distance [m] to the mean; `score`
    is as in the paper.
    """

    frame: str
    members: tuple[int, ...]
    mean: tuple[float, ...]
    radius: float
    score: float


def score(points: Array, floor_m: float = 0.0) -> float:
    """Size over the greatest distance [m] to the mean of `points` (n, 3); -inf for a single point (section III-E).

    `floor_m` is added to the distance; without it, points that all coincide score +inf.
    """
    if len(points) <= 1:
        return -np.inf
    radius = greatest_distance(points) + floor_m
    return len(points) / radius if radius > 0 else np.inf


def greatest_distance(points: Array) -> float:
    """The greatest distance [m] of `points` (n, 3) to their mean."""
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())


def dbscan(points: Array, eps_m: float, min_samples: int) -> NDArray[np.intp]:
    """A label (n,) for each of `points` (n, 3): clusters from 0, -1 for noise. A sample is its own neighbour."""
    from sklearn.cluster import DBSCAN

    if len(points) < min_samples:
        return np.full(len(points), -1, dtype=np.intp)
    # The default for few points runs in threads that wait for one another: ten times slower on a busy machine.
    return np.asarray(DBSCAN(eps=eps_m, min_samples=min_samples, algorithm="kd_tree").fit(points).labels_)


def clusters_in_frame(
    frame: str, samples: NDArray[np.intp], points: Array, eps_m: float, min_samples: int, floor_m: float = 0.0
) -> list[Cluster]:
    """The clusters of `samples` (n,), whose positions in `frame` [m] are `points` (n, 3)."""
    labels = dbscan(points, eps_m, min_samples)
    found = []
    for label in range(labels.max(initial=-1) + 1):
        inside = labels == label
        found.append(of_members(frame, samples[inside], points[inside], floor_m))
    return found


def of_members(frame: str, samples: NDArray[np.intp], points: Array, floor_m: float = 0.0) -> Cluster:
    """The cluster of these samples at these `points` (n, 3)."""
    mean = tuple(points.mean(axis=0).tolist())
    members = tuple(int(sample) for sample in samples)
    return Cluster(frame, members, mean, greatest_distance(points), score(points, floor_m))
