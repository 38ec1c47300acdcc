"""How targets are found, after the paper's section III-E: clusters in every candidate frame, the best one first.

The frame of a cluster is the one that the evidence speaks for (`learner.inference.frames`); contexts are split only
where a demonstration repeats a target (`learner.inference.contexts`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from learner.inference.clustering import Cluster, clusters_in_frame
from learner.inference.contexts import by_time
from learner.inference.dbscan import dbscan
from learner.inference.frames import belong_together, dropped, frames_of, intended, richer_frames
from learner.inference.moves import LeftOut, Moves
from learner.inference.parameters import InferenceParameters
from learner.inference.targets import Target, in_frame, target_of
from learner.inference.ties import Anchored, anchors_of, tied_frames
from learner.model.frame import START
from learner.model.pose import Array
from learner.model.poses import Rows


def find_targets(moves: Moves, parameters: InferenceParameters) -> list[Target]:
    """Every supported target of all moves of a task, ordered by object and by when it is reached."""
    enough = enough_of(moves, parameters)
    found: list[Target] = []
    for name in np.unique(moves.object[moves.released]):
        numbers = np.flatnonzero(moves.released & (moves.object == name))
        plain = _of_object(numbers, moves, enough, parameters) or _pairs(numbers, moves, parameters)
        found += _richer_if_better(plain, numbers, moves, parameters)
    anchored = anchors_of(moves, found)
    return [with_ties(target, anchored, moves, parameters) for target in found]


def _richer_if_better(
    plain: Sequence[Target], numbers: Rows, moves: Moves, parameters: InferenceParameters
) -> Sequence[Target]:
    """The targets in frames that go by two objects or by the base's axes, where those explain more of one object's
    moves than its targets in plain frames, which leave more than a few unexplained or are but pairs.
    """
    meant = numbers[~moves.put_back[numbers]]
    explained = np.sort(np.array([number for target in plain for number in target.members], dtype=np.intp))
    left = np.setdiff1d(meant, explained)
    fleeting = [number for target in find_fleeting(left, moves, parameters) for number in target.members]
    left = np.setdiff1d(left, fleeting)
    only_pairs = len(left) and all(len(target.members) < parameters.min_samples for target in plain)
    if not only_pairs and len(left) <= parameters.few_unexplained * len(meant):
        return plain
    richer = [t for t in find_richer(np.setdiff1d(meant, fleeting), moves, parameters) if not t.frame.endswith(START)]
    return richer if sum(len(target.members) for target in richer) > len(explained) else plain


def find_passed(left_out: LeftOut, parameters: InferenceParameters) -> list[Target]:
    """Where enough demonstrations bring an object that their next move takes further; members are moves left out."""
    moves, corrected = left_out.moves, left_out.corrected
    enough, names = enough_of(moves, parameters), moves.object[corrected]
    return [t for name in np.unique(names) for t in _of_object(corrected[names == name], moves, enough, parameters)]


def enough_of(moves: Moves, parameters: InferenceParameters) -> Enough:
    """How many of all demonstrations, and users, must share a cluster."""
    samples = moves.samples
    users = parameters.users_for(len(np.unique(samples.users)))
    return Enough(parameters.samples_for(len(samples.numbers)), users)


@dataclass(frozen=True)
class Enough:
    """What makes a target: how many demonstrations, and users, must share a cluster; the `richer` frames that are
    candidates beside those of all objects; and whether it must be `lasting`.
    """

    samples: int
    users: int
    richer: tuple[str, ...] = ()
    lasting: bool = True

    def share(self, numbers: Sequence[int], moves: Moves) -> bool:
        """Whether enough share these moves, and most of them did not merely put the object back."""
        members = np.asarray(numbers, dtype=np.intp)
        if 2 * moves.put_back[members].sum() > len(members):
            return False
        demonstrations = np.unique(moves.demonstration[members])
        users = np.unique(moves.samples.users[demonstrations])
        return len(users) >= self.users and len(demonstrations) >= self.samples


def find_richer(numbers: Rows, moves: Moves, parameters: InferenceParameters) -> list[Target]:
    """The targets of one object's moves `numbers` that no object's own frame explains, in frames that are more."""
    richer = tuple(richer_frames(moves.releases(numbers)))
    return [target for target in _found(numbers, moves, parameters, richer) if target.frame in richer]


def find_fleeting(numbers: Rows, moves: Moves, parameters: InferenceParameters) -> list[Target]:
    """The places to which one object's moves `numbers` bring it though it does not stay there."""
    found = _found(numbers, moves, parameters, lasting=False)
    return [target for target in found if target.frame not in frames_of(target.members, moves, parameters)]


def _found(
    numbers: Rows, moves: Moves, parameters: InferenceParameters, richer: Sequence[str] = (), lasting: bool = True
) -> list[Target]:
    enough = replace(enough_of(moves, parameters), richer=tuple(richer), lasting=lasting)
    return _of_object(numbers, moves, enough, parameters) if len(numbers) else []


def _of_object(numbers: Rows, moves: Moves, enough: Enough, parameters: InferenceParameters) -> list[Target]:
    """The targets of one object: of clusters in a narrow neighbourhood, which tells neighbouring placements apart, then
    in a wide one; of drops in the wide one, then in one as wide as they may lie apart.
    """
    p = parameters
    wide_only = dropped(moves.releases(numbers), p)
    left, found = numbers, list[Target]()
    for eps_m in (p.eps_wide_m, p.eps_drop_m) if wide_only else (p.eps_place_m, p.eps_wide_m):
        while cluster := _best(left, eps_m, moves, enough, p):
            targets = _contexts(cluster, moves, enough, len(left), p)
            found += targets
            left = np.setdiff1d(left, [*cluster.members, *(number for target in targets for number in target.members)])
    return _in_order(_joined(found, moves, p), moves)


def _joined(targets: Sequence[Target], moves: Moves, parameters: InferenceParameters) -> list[Target]:
    """The targets, those that are one by the evidence joined: what scatters widely may look like several clusters."""
    found: list[Target] = []
    for target in targets:
        same = next((other for other in found if _are_one(other, target, moves, parameters)), None)
        whole = target_of(sorted((*same.members, *target.members)), moves, parameters) if same else None
        if same and whole:
            found[found.index(same)] = whole
        else:
            found.append(target)
    return found


def _are_one(one: Target, other: Target, moves: Moves, parameters: InferenceParameters) -> bool:
    """Whether no demonstration reaches both, and the evidence speaks for one place."""
    shown = moves.demonstration
    both = np.intersect1d(shown[list(one.members)], shown[list(other.members)])
    alike = (one.frame, one.type) == (other.frame, other.type)
    return alike and not len(both) and belong_together(one.members, other.members, one.frame, moves, parameters)


def _pairs(numbers: Rows, moves: Moves, parameters: InferenceParameters) -> list[Target]:
    """Targets of an object that fewer demonstrations share than make a cluster, though too near for chance.

    Only where there are enough demonstrations to tell, and most of them move the object: it belongs to the task. Of
    many placements two are near by chance: what is not sure is left out.
    """
    everyone, count = len(moves.samples.numbers), len(np.unique(moves.demonstration[numbers]))
    if everyone < parameters.min_samples or 2 * count <= everyone:
        return []
    least = max(2, math.ceil(parameters.min_share * everyone))
    left, found, two, eps_m = numbers, list[Target](), Enough(least, 1), parameters.eps_pair_m
    while cluster := _best(left, eps_m, moves, two, parameters):
        targets = _contexts(cluster, moves, two, len(left), parameters)
        found += [target for target in targets if target.certainty >= parameters.sure]
        left = np.setdiff1d(left, cluster.members)
    return _in_order(found, moves)


def _in_order(targets: Sequence[Target], moves: Moves) -> list[Target]:
    """By when they are reached."""
    when = {target: float(np.mean(moves.releases(target.members).step)) for target in targets}
    return sorted(targets, key=lambda target: (when[target], target.members))


def _best(numbers: Rows, eps_m: float, moves: Moves, enough: Enough, parameters: InferenceParameters) -> Cluster | None:
    """The cluster with the highest score among those that enough users and demonstrations share, with its strays."""
    if len(numbers) < enough.samples:
        return None
    samples, floor_m = moves.releases(numbers), parameters.noise_floor_m
    best: tuple[Cluster, Rows, Array] | None = None
    for frame in (*samples.frames, *enough.richer):
        known = np.flatnonzero(samples.candidate(frame))
        points = intended(frame, samples, parameters)[known]
        labels = dbscan(points, eps_m, enough.samples)
        for cluster in clusters_in_frame(frame, numbers[known], points, labels, floor_m):
            if (best is None or cluster.score > best[0].score) and enough.share(cluster.members, moves):
                best = cluster, numbers[known[labels < 0]], points[labels < 0]
    return _with_strays(*best, eps_m, parameters) if best else None


def _with_strays(
    cluster: Cluster, strays: Rows, points: Array, eps_m: float, parameters: InferenceParameters
) -> Cluster:
    """The cluster with those strays, which lie at `points` (k, 3) in its frame, that are near it."""
    away = np.linalg.norm(points - np.array(cluster.mean), axis=1)
    reach_m = max(eps_m, parameters.eps_wide_m) if eps_m >= parameters.eps_place_m else eps_m
    return replace(cluster, strays=tuple(strays[away < reach_m].tolist()))


def _contexts(
    cluster: Cluster, moves: Moves, enough: Enough, among: int, parameters: InferenceParameters
) -> list[Target]:
    """The targets in one cluster, which was found `among` so many moves: several where demonstrations repeat it, told
    apart by which time it is.
    """

    def shared(members: Sequence[int]) -> bool:
        return enough.share(members, moves)

    kept = [members for members in by_time((*cluster.members, *cluster.strays), moves, shared) if shared(members)]
    among -= sum(map(len, kept)) - max(map(len, kept), default=0)  # what the other times take is not left to chance
    found = (
        target_of(members, moves, parameters, context, among, enough.richer, enough.lasting)
        for context, members in enumerate(kept)
    )
    return [target for target in found if target]


def with_ties(target: Target, anchored: Anchored, moves: Moves, parameters: InferenceParameters) -> Target:
    """With the frames that the task keeps rigid with the chosen one.

    Of those, what the object rests upon is chosen: there it is to lie whatever becomes of the rest.
    """
    tied = tied_frames(target, anchored)
    frame = target.upon[0] if target.upon else target.frame
    if frame not in tied or target.frames[frame] < parameters.likely:
        return replace(target, tied=tied)
    return replace(in_frame(target, frame, moves, parameters), tied=(tied | {target.frame}) - {frame})
