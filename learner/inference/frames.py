"""Which frame the evidence speaks for: the posterior probability of every candidate frame.

A rigid change of frame keeps volumes, so the densities of one set of positions in different frames are comparable
directly. In the true frame positions scatter normally about an unknown mean with an unknown variance (inverse gamma
beforehand); the marginal density of n positions with sum of squares S is then proportional to
(b + S/2)^-(a + 3(n - 1)/2), and Bayes' rule gives the posterior. Where several frames scatter alike, none is certain.
What is near is likelier beforehand, and a frame in which the object does not stay is none.

The frames have a rival, NO_FRAME: the object goes anywhere on the table, at a height that scatters as in a frame. So
many demonstrations of what no frame explains make the learner surer that none does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final

import numpy as np

from learner.inference.moves import Moves
from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Samples
from learner.inference.support import scene_of_first, stayed, support_of
from learner.model.frame import at_start, between, on_axes
from learner.model.names import NONE
from learner.model.pose import Array
from learner.model.poses import Mask

NO_FRAME: Final = NONE
"""Stands for no frame at all; no object may be called so."""


def frames_of(
    members: Sequence[int], moves: Moves, parameters: InferenceParameters, among: int | None = None,
    richer: Sequence[str] = (), lasting: bool = True,
) -> dict[str, float]:  # fmt: skip
    """The posterior probability of every frame that all these moves know and keep their place in, likeliest first, and
    of NO_FRAME.

    The moves were chosen `among` so many for lying together (None: these are all); the more ways there are to choose
    as many, the likelier it is that some lie together by chance. `richer` frames (`richer_frames`) are as likely
    beforehand, all together, as the base.
    Empty if the evidence speaks for no frame, or, if `lasting`, for one in which the object does not stay: a placement
    that does not last.
    """
    samples = moves.releases(members)
    sigma_m = parameters.drop_sigma_m if dropped(samples, parameters) else parameters.place_sigma_m
    upon = support_of(samples, parameters)
    carrier = upon[0] if upon else None
    logs = {NO_FRAME: log_density_anywhere(samples, sigma_m, parameters)}
    odds = {NO_FRAME: parameters.no_frame_odds * math.comb(max(among or 0, len(samples)), len(samples))}
    for frame in (*samples.common_frames, *richer):
        logs[frame] = log_density(intended(frame, samples, parameters), sigma_m, parameters.sigma_shape)
        odds[frame] = 1 / len(richer) if frame in richer else _odds(frame, samples, carrier, parameters)
    shares = posterior(logs, odds)
    if lasting:
        kept = {frame for frame in shares if frame == NO_FRAME or _lasts(frame, samples, parameters.lost_m)}
        shares = {frame: share for frame, share in shares.items() if frame in kept}
    total = sum(shares.values())
    if next(iter(shares)) == NO_FRAME or total - shares[NO_FRAME] <= parameters.transient:
        return {}
    return {frame: share / total for frame, share in shares.items()}


def richer_frames(samples: Samples) -> list[str]:
    """The frames that are candidates for all samples and go by more than one object, by the base's axes, or by where an
    object stood at the beginning (`learner.model.frame`).
    """
    names = [frame for frame in samples.common_frames if frame != samples.base]
    pairs = [between(one, other) for one, other in combinations(names, 2)]
    starts = [at_start(name) for name in sorted({*names, str(samples.object[0])})]
    found = (*pairs, *map(on_axes, names), *starts)
    return [frame for frame in found if samples.candidate(frame).all()]


def dropped(samples: Samples, parameters: InferenceParameters) -> bool:
    """Whether most releases were drops, by their label or by the height they fell from."""
    columns, height_m = samples.columns, parameters.drop_height_m

    def fell() -> Mask:
        return np.asarray((columns.type == "drop") | (np.nan_to_num(columns.fall_m) > height_m))

    return bool(2 * columns.once(("fell", height_m), fell)[samples.rows].sum() > len(samples))


def intended(frame: str, samples: Samples, parameters: InferenceParameters) -> Array:
    """What tells, in a frame, where an object was meant to go (m, 3) [m]: its rest, or, dropped, its release."""
    poses = samples.release(frame) if dropped(samples, parameters) else samples.rest(frame)
    return poses.positions


def log_density(points: Array, sigma_m: float, shape: float) -> float:
    """The logarithm of the marginal density of `points` (n, d) in a frame, but for that of the unknown mean.

    `sigma_m` is the scatter [m] expected per axis, `shape` how firmly.
    """
    count, axes = points.shape
    freedom = axes * (count - 1) / 2
    sum_of_squares = float(((points - points.mean(axis=0)) ** 2).sum())
    scale = shape * sigma_m**2
    gammas = math.lgamma(shape + freedom) - math.lgamma(shape)
    constant = gammas + shape * math.log(scale) - freedom * math.log(2 * math.pi) - axes / 2 * math.log(count)
    return float(constant - (shape + freedom) * math.log(scale + sum_of_squares / 2))


def log_density_anywhere(samples: Samples, sigma_m: float, parameters: InferenceParameters) -> float:
    """The same for what lies anywhere on the table, the first of the points given, and at a height that scatters."""
    heights = intended(samples.base, samples, parameters)[:, 2:]
    anywhere = (len(samples) - 1) * math.log(table_m2(samples, parameters))
    return log_density(heights, sigma_m, parameters.sigma_shape) - anywhere


def table_m2(samples: Samples, parameters: InferenceParameters) -> float:
    """The area [m²] on which objects may lie."""
    scene = scene_of_first(samples)
    if scene is None or scene.workspace_m is None:
        return parameters.table_m2
    return math.prod(high - low for low, high in scene.workspace_m)


def belong_together(
    some: Sequence[int], others: Sequence[int], frame: str, moves: Moves, parameters: InferenceParameters
) -> bool:
    """Whether the evidence speaks for one place of all these moves in a frame, rather than for two.

    Two places have a mean each, which may be anywhere on the table, and each move is meant for either.
    """
    samples = moves.releases([*some, *others])
    sigma_m = parameters.drop_sigma_m if dropped(samples, parameters) else parameters.place_sigma_m
    points, shape = intended(frame, samples, parameters), parameters.sigma_shape
    apart = (log_density(part, sigma_m, shape) for part in (points[: len(some)], points[len(some) :]))
    choice = len(points) * math.log(2) + math.log(table_m2(samples, parameters))
    return log_density(points, sigma_m, shape) > sum(apart) - choice


def posterior(log_densities: Mapping[str, float], odds: Mapping[str, float]) -> dict[str, float]:
    """The posterior probability of each frame, the likeliest first; ties by name. `odds` are those beforehand."""
    names = sorted(log_densities)
    logs = np.array([log_densities[name] + math.log(odds[name]) for name in names])
    weights = np.exp(logs - logs.max())
    shares = weights / weights.sum()
    order = sorted(range(len(names)), key=lambda index: (-shares[index], names[index]))
    return {names[index]: float(shares[index]) for index in order}


def _odds(frame: str, samples: Samples, carrier: str | None, parameters: InferenceParameters) -> float:
    if frame == samples.base:
        return 1.0
    if frame == carrier:
        return parameters.upon_odds
    gap_m, odds = _gap_m(frame, samples, parameters.cube_m), parameters.contact_odds
    return odds * (1.1 - gap_m) if gap_m < parameters.contact_m else 1 / odds


def _gap_m(frame: str, samples: Samples, cube_m: float) -> float:
    """How far the object's origin rests from the other one: as if that were a cube as near as its size lets."""
    scene = scene_of_first(samples)
    shape = scene.objects.get(frame) if scene else None
    half = np.maximum(np.array(shape.size_m) - cube_m, 0.0) / 2 if shape else np.zeros(3)

    def gaps_m() -> Array:
        rests = np.abs(samples.columns.rest(frame).positions)
        return np.asarray(np.linalg.norm(np.maximum(rests - half, 0.0), axis=1))

    return float(np.median(samples.columns.once(("gap", frame, *half.tolist()), gaps_m)[samples.rows]))


def _lasts(frame: str, samples: Samples, lost_m: float) -> bool:
    """Whether the object kept its place in the frame in most demonstrations until it was moved again."""
    return bool(2 * stayed(frame, samples, lost_m).sum() > len(samples))
