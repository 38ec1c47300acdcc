"""Which frame the evidence speaks for: the posterior probability of every candidate frame.

A rigid change of frame keeps volumes, so the densities of one set of positions in different frames are comparable
directly. In the true frame positions scatter normally about an unknown mean with an unknown variance (inverse gamma
beforehand); the marginal density of n positions with sum of squares S is then proportional to
(b + S/2)^-(a + 3(n - 1)/2), and Bayes' rule gives the posterior. Where several frames scatter alike, none is certain.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from learner.model.pose import Array


def log_density(points: Array, sigma_m: float, shape: float) -> float:
    """The logarithm of the marginal density of `points` (n, 3) in a frame, up to a constant that depends on n alone.

    `sigma_m` is the scatter [m] expected per axis, `shape` how firmly.
    """
    sum_of_squares = float(((points - points.mean(axis=0)) ** 2).sum())
    exponent = shape + 3 * (len(points) - 1) / 2
    return -exponent * float(np.log(shape * sigma_m**2 + sum_of_squares / 2))


def posterior(log_densities: Mapping[str, float], odds: Mapping[str, float]) -> dict[str, float]:
    """The posterior probability of each frame, the likeliest first; ties by name. `odds` are those beforehand."""
    names = sorted(log_densities)
    logs = np.array([log_densities[name] + np.log(odds[name]) for name in names])
    weights = np.exp(logs - logs.max())
    shares = weights / weights.sum()
    order = sorted(range(len(names)), key=lambda index: (-shares[index], names[index]))
    return {names[index]: float(shares[index]) for index in order}
