"""Clusters of positions in a candidate frame (paper, section III-E): DBSCAN, and the score of a cluster."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from learner.model.pose import Array


@dataclass(frozen=True)
class Cluster:
    """Samples that lie together in `frame`.

    `members` are sorted sample numbers, `strays` those near it that lie in no cluster of their own; `mean` [m]: (3,);
    `radius` is the greatest distance [m] of a member to the mean; `score` is as in the paper.
    """

    frame: str
    members: tuple[int, ...]
    mean: tuple[float, ...]
    radius: float
    score: float
    strays: tuple[int, ...] = ()


def score(points: Array, floor_m: float = 0.0) -> float:
    """Size over the greatest distance [m] to the mean of `points` (n, 3); -inf for a single point (section III-E).

    `floor_m` is added to the distance; without it, points that all coincide score +inf.
    """
    return _score(len(points), greatest_distance(points) + floor_m)


def _score(count: int, radius_m: float) -> float:
    if count <= 1:
        return -np.inf
    return count / radius_m if radius_m > 0 else np.inf


def greatest_distance(points: Array) -> float:
    """The greatest distance [m] of `points` (n, 3) to their mean."""
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())


def clusters_in_frame(
    frame: str, samples: NDArray[np.intp], points: Array, labels: NDArray[np.intp], floor_m: float = 0.0
) -> list[Cluster]:
    """The clusters of `samples` (n,), whose positions in `frame` [m] are `points` (n, 3); by their `labels` (n,)."""
    found = []
    by_label = np.argsort(labels, kind="stable")
    for inside in np.split(by_label, np.searchsorted(labels[by_label], np.arange(labels.max(initial=-1) + 1)))[1:]:
        found.append(of_members(frame, samples[inside], points[inside], floor_m))
    return found


def of_members(frame: str, samples: NDArray[np.intp], points: Array, floor_m: float = 0.0) -> Cluster:
    """The cluster of these samples at these `points` (n, 3)."""
    mean = tuple(points.mean(axis=0).tolist())
    radius = greatest_distance(points)
    return Cluster(frame, tuple(samples.tolist()), mean, radius, _score(len(points), radius + floor_m))
