"""Targets: where a task puts an object. Placements of one object, across demonstrations and users, that mean the same.

Ours, after the paper's section III-E: clusters in every candidate frame, the best one gives the members; the frame is
the one the evidence speaks for (`learner.inference.frames`); contexts are split only where a
demonstration repeats a target.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from learner.inference.clustering import Cluster, clusters_in_frame, dbscan, greatest_distance
from learner.inference.frames import log_density, posterior
from learner.inference.labels import Verdict, fall_m, verdict
from learner.inference.moves import Move, release_sample
from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Sample, candidate_frames, positions_in
from learner.model import Demonstration, Pose
from learner.model.pose import Array, Vector, conjugate, express, multiply, rotate

LIKELY = 0.02
"""What an object rests upon stands in for a frame that the task keeps rigid with it from this probability on."""
CUBE_M = 0.05
"""Distances between objects are those between the middles of cubes of this size."""
LOST_M = 0.04
"""An object further than this from where it rested in a frame has not kept its place in that frame."""


@dataclass(frozen=True)
class Target:
    """One place of one object.

    `members` are numbers of moves; `frames` the posterior probability of each candidate frame, `frame` the one
    chosen; `rests` [m] (n, 3) and `releases` are the object's poses in it.
    """

    object: str
    frame: str
    members: tuple[int, ...]
    frames: Mapping[str, float] = field(compare=False)
    verdict: Verdict = field(compare=False)
    rests: tuple[Pose, ...] = field(compare=False)
    releases: tuple[Pose, ...] = field(compare=False)
    context: int = 0
    supported: bool = True
    upon: tuple[str, Vector] | None = None
    """What the object rests upon, and where in its frame [m]; None if that is no object, or it rests in one."""
    tied: frozenset[str] = field(default=frozenset())
    """Frames that the task itself keeps rigid with the chosen one: they are not rivals."""

    @property
    def spread_m(self) -> float:
        return greatest_distance(np.array([rest.position for rest in self.rests]))

    @property
    def certainty(self) -> float:
        """The posterior probability of the chosen frame and those tied to it."""
        return sum(share for frame, share in self.frames.items() if frame == self.frame or frame in self.tied)

    def rival(self) -> str | None:
        """The likeliest other frame; None if there is none."""
        return next((frame for frame in self.frames if frame != self.frame and frame not in self.tied), None)


class TargetFinder:
    """Finds the targets of all moves of a task."""

    def __init__(
        self, demonstrations: Sequence[Demonstration], moves: Sequence[Move], parameters: InferenceParameters
    ) -> None:
        self.demonstrations, self.moves, self.parameters = demonstrations, moves, parameters
        self.samples: list[Sample | None] = [
            None if move.release is None else release_sample(demonstrations, move) for move in moves
        ]
        self.min_samples = parameters.samples_for(len(demonstrations))
        self.min_users = parameters.users_for(len({demonstration.user for demonstration in demonstrations}))

    def find(self) -> list[Target]:
        """Every supported target, ordered by object and by when it is reached."""
        by_object: dict[str, list[int]] = defaultdict(list)
        for number, move in enumerate(self.moves):
            if self.samples[number] is not None:
                by_object[move.object].append(number)
        found = [target for name in sorted(by_object) for target in self._of_object(by_object[name])]
        anchors = self._anchors(found)
        return [self._with_ties(target, anchors) for target in found]

    def alone(self, number: int) -> Target:
        """A move that fits nowhere, in the default frame: the base (section III-E)."""
        return self._target((number,), self._sample(number).base_frame, {}, 0, supported=False)

    def _sample(self, number: int) -> Sample:
        sample = self.samples[number]
        assert sample is not None
        return sample

    def _of_object(self, numbers: Sequence[int]) -> list[Target]:
        left, found = set(numbers), []
        for eps_m in self._neighbourhoods(numbers):
            while cluster := self._best(sorted(left), eps_m):
                targets = self._contexts(self._with_strays(cluster, sorted(left), eps_m))
                found += targets
                left -= {*cluster.members, *(number for target in targets for number in target.members)}
        found = found or self._pairs(numbers)
        return sorted(found, key=lambda target: (self._when(target.members), target.members))

    def _pairs(self, numbers: Sequence[int]) -> list[Target]:
        """Targets of an object that fewer demonstrations share than make a cluster, though too near for chance.

        Only where there are enough demonstrations to tell, and most of them move the object: it belongs to the task.
        """
        count = len({self._sample(number).demonstration for number in numbers})
        if len(self.demonstrations) < self.parameters.min_samples or 2 * count <= len(self.demonstrations):
            return []
        lenient = TargetFinder(self.demonstrations, self.moves, self.parameters)
        lenient.min_samples, lenient.min_users = 2, 1
        left, found = set(numbers), []
        while cluster := lenient._best(sorted(left), self.parameters.eps_pair_m):
            found += lenient._contexts(lenient._with_strays(cluster, sorted(left), self.parameters.eps_pair_m))
            left -= set(cluster.members)
        return found

    def _neighbourhoods(self, numbers: Sequence[int]) -> tuple[float, ...]:
        """The narrow neighbourhood first, which tells neighbouring placements apart; for drops the wide one alone."""
        p = self.parameters
        return (p.eps_wide_m,) if self._dropped(numbers) else (p.eps_place_m, p.eps_wide_m)

    def _dropped(self, numbers: Sequence[int]) -> bool:
        """Whether most were dropped, by their label or by the height they fell from."""
        return sum(self._fell(self._sample(number)) for number in numbers) * 2 > len(numbers)

    def _fell(self, sample: Sample) -> bool:
        return sample.action.type == "drop" or (fall_m(sample) or 0.0) > self.parameters.drop_height_m

    def _what(self, numbers: Sequence[int]) -> str:
        """What tells where an object was meant to go: its rest, or, where it was dropped and rolled, its release."""
        return "release" if self._dropped(numbers) else "rest"

    def _when(self, members: Sequence[int]) -> float:
        return float(np.mean([self._sample(number).action.step for number in members]))

    def _best(self, numbers: Sequence[int], eps_m: float) -> Cluster | None:
        """The cluster with the highest score among those that enough users and demonstrations share."""
        samples = [self._sample(number) for number in numbers]
        best: Cluster | None = None
        for frame in candidate_frames(samples):
            known, points = positions_in(frame, samples, range(len(samples)), self._what(numbers))
            floor_m = self.parameters.noise_floor_m
            for cluster in clusters_in_frame(frame, known, points, eps_m, self.min_samples, floor_m):
                members = tuple(numbers[index] for index in cluster.members)
                if self._quorum(members) and (best is None or cluster.score > best.score):
                    best = Cluster(frame, members, cluster.mean, cluster.radius, cluster.score)
        return best

    def _with_strays(self, cluster: Cluster, numbers: Sequence[int], eps_m: float) -> Cluster:
        """The cluster with the samples near it that lie in no cluster of their own."""
        samples = [self._sample(number) for number in numbers]
        known, points = positions_in(cluster.frame, samples, range(len(samples)), self._what(numbers))
        labels = dbscan(points, eps_m, self.min_samples)
        away = np.linalg.norm(points - np.array(cluster.mean), axis=1)
        reach_m = max(eps_m, self.parameters.eps_wide_m) if eps_m >= self.parameters.eps_place_m else eps_m
        strays = {numbers[known[i]] for i in np.flatnonzero((labels < 0) & (away < reach_m))}
        return replace(cluster, members=tuple(sorted(strays | set(cluster.members))))

    def _quorum(self, numbers: Sequence[int]) -> bool:
        """Whether enough demonstrations and users share it, and most of them did not merely put the object back."""
        if 2 * sum(self.moves[number].put_back for number in numbers) > len(numbers):
            return False
        users = {self._sample(number).user for number in numbers}
        demonstrations = {self._sample(number).demonstration for number in numbers}
        return len(users) >= self.min_users and len(demonstrations) >= self.min_samples

    def _contexts(self, cluster: Cluster) -> list[Target]:
        """The targets in one cluster: several where demonstrations repeat it, told apart by which time it is."""
        kept = [members for members in self._times(cluster.members) if self._quorum(members)]
        found = [(members, self._evidence(members)) for members in kept]
        return [self._target(members, None, frames, k) for k, (members, frames) in enumerate(found) if frames]

    def _times(self, members: Sequence[int]) -> list[tuple[int, ...]]:
        """The members by which time it is that they reach the target: as many times as enough demonstrations share.

        One that reaches it fewer times (or more) is matched by how far it had come then, as those usually had.
        """
        turns: dict[int, list[int]] = defaultdict(list)
        for number in sorted(members):
            turns[self._sample(number).demonstration].append(number)
        times = max((k for k in range(1, 1 + max(map(len, turns.values()))) if self._shared(turns, k)), default=1)
        usual = [[self._progress(number) for number in turn] for turn in turns.values() if len(turn) == times]
        when = np.mean(usual or [[0.0] * times], axis=0)
        matched = [self._matched(turn, when) for turn in turns.values()]
        return [tuple(turn[k] for turn in matched if k in turn) for k in range(times)]

    def _shared(self, turns: Mapping[int, Sequence[int]], times: int) -> bool:
        return self._quorum([turn[times - 1] for turn in turns.values() if len(turn) >= times])

    def _progress(self, number: int) -> float:
        """How much of its demonstration was done when a move ended, from 0 to 1."""
        sample = self._sample(number)
        return sample.action.step / len(self.demonstrations[sample.demonstration].actions)

    def _matched(self, turn: Sequence[int], when: Array) -> dict[int, int]:
        """Which move of one demonstration belongs to which time, in order, as near as can be to `when` (times,)."""
        if len(turn) == len(when):
            return dict(enumerate(turn))
        from scipy.optimize import linear_sum_assignment

        done = np.array([self._progress(number) for number in turn])
        times, moves = linear_sum_assignment(np.abs(np.subtract.outer(np.array(when), done)))
        return {int(k): turn[int(n)] for k, n in zip(sorted(times), sorted(moves), strict=True)}

    def _evidence(self, members: Sequence[int]) -> dict[str, float]:
        """The posterior probability of every frame that all members know and keep their place in.

        Empty if the evidence speaks for a frame in which the object does not stay: a placement that does not last.
        """
        samples = [self._sample(number) for number in members]
        p, logs, odds = self.parameters, {}, {}
        sigma_m = p.drop_sigma_m if self._dropped(members) else p.place_sigma_m
        upon = self._upon(samples)
        frames = [frame for frame in candidate_frames(samples) if all(frame in s.frames for s in samples)]
        for frame in frames:
            points = positions_in(frame, samples, range(len(samples)), self._what(members))[1]
            logs[frame] = log_density(points, sigma_m, p.sigma_shape)
            odds[frame] = self._odds(frame, samples, upon[0] if upon else None)
        shares = posterior(logs, odds)
        lasting = {frame: share for frame, share in shares.items() if self._lasts(frame, members)}
        total = sum(lasting.values())
        return {frame: share / total for frame, share in lasting.items()} if total > p.transient else {}

    def _odds(self, frame: str, samples: Sequence[Sample], carrier: str | None) -> float:
        if frame == samples[0].base_frame:
            return 1.0
        if frame == carrier:
            return self.parameters.upon_odds
        gap_m = self._gap_m(frame, samples)
        odds = self.parameters.contact_odds
        return odds * (1.1 - gap_m) if gap_m < self.parameters.contact_m else 1 / odds

    def _gap_m(self, frame: str, samples: Sequence[Sample]) -> float:
        """How far the object's origin rests from the other one: as if that were a cube as near as its size lets."""
        scene = self.demonstrations[samples[0].demonstration].scene
        shape = scene.objects.get(frame) if scene else None
        half = np.maximum(np.array(shape.size_m) - CUBE_M, 0.0) / 2 if shape else np.zeros(3)
        rests = np.abs([sample.rest(frame).position for sample in samples])
        return float(np.median(np.linalg.norm(np.maximum(rests - half, 0.0), axis=1)))

    def _away(self, frame: str, samples: Sequence[Sample]) -> float:
        return float(np.median([np.linalg.norm(sample.rest(frame).position) for sample in samples]))

    def _lasts(self, frame: str, members: Sequence[int]) -> bool:
        """Whether the object kept its place in the frame in most demonstrations until it was moved again."""
        kept = [self._kept(frame, number) for number in members]
        return sum(kept) * 2 > len(kept)

    def _kept(self, frame: str, number: int) -> bool:
        sample = self._sample(number)
        demonstration, name = self.demonstrations[sample.demonstration], sample.action.object
        worlds = [
            world
            for world in _worlds_after(demonstration, sample.action.step, name)
            if name in world and (frame in world or frame == sample.base_frame)
        ]
        if not worlds:
            return True
        at = np.array([world[name].position for world in worlds])
        if frame != sample.base_frame:
            origins = np.array([world[frame].position for world in worlds])
            at = express(at, origins, np.array([world[frame].quaternion_xyzw for world in worlds]))
        away = np.linalg.norm(at - np.array(sample.rest(frame).position), axis=1)
        return bool(away.max() <= LOST_M)

    def _target(
        self, members: tuple[int, ...], frame: str | None, frames: Mapping[str, float], context: int,
        supported: bool = True,
    ) -> Target:  # fmt: skip
        frame = frame or next(iter(frames))
        samples = [self._sample(number) for number in members]
        rests = tuple(sample.rest(frame) for sample in samples)
        spread_m = greatest_distance(np.array([rest.position for rest in rests]))
        upon = self._upon(samples)
        fits = verdict(samples, spread_m, upon is not None, self.parameters)
        releases = tuple(sample.release(frame) for sample in samples)
        name = samples[0].action.object
        return Target(name, frame, members, frames, fits, rests, releases, context, supported, upon)

    def _upon(self, samples: Sequence[Sample]) -> tuple[str, Vector] | None:
        """The nearest object that the samples' object rests upon, and the median of where."""
        known = [frame for frame in samples[0].action.frames if all(frame in s.action.frames for s in samples)]
        under = [frame for frame in known if self._on_top(frame, samples)]
        if not under:
            return None
        nearest = min(under, key=lambda frame: self._away(frame, samples))
        x, y, z = np.median([sample.rest(nearest).position for sample in samples], axis=0).tolist()
        return nearest, (x, y, z)

    def _on_top(self, frame: str, samples: Sequence[Sample]) -> bool:
        """Whether the object rests upon the one whose frame this is."""
        offsets = _offsets_in_base(frame, samples)
        x, y, z = np.median(offsets, axis=0)
        above = np.hypot(x, y) < self.parameters.tight_m * 1.5 and z > self._top_m(frame, samples)
        return bool(above and (self._sizes_known(frame, samples) or self._raised(samples)))

    def _raised(self, samples: Sequence[Sample]) -> bool:
        """Whether the object rests higher than where it begins: a box's floor does not raise it, a cube does."""
        name = samples[0].action.object
        begins_m = min(d.first_seen[name].position[2] for d in self.demonstrations if name in d.first_seen)
        rests_m = [s.action.rest[s.base_frame].position[2] for s in samples if s.action.rest is not None]
        return bool(np.median(rests_m) - begins_m > self.parameters.tight_m)

    def _sizes_known(self, frame: str, samples: Sequence[Sample]) -> bool:
        scene = self.demonstrations[samples[0].demonstration].scene
        return scene is not None and {frame, samples[0].action.object} <= set(scene.objects)

    def _top_m(self, frame: str, samples: Sequence[Sample]) -> float:
        """How far above a frame's origin an object's origin must be to rest upon it: most of both half heights."""
        scene = self.demonstrations[samples[0].demonstration].scene
        name = samples[0].action.object
        if scene is None or not self._sizes_known(frame, samples):
            return self.parameters.tight_m
        return 0.4 * (min(scene.objects[frame].size_m) + min(scene.objects[name].size_m))

    def _with_ties(self, target: Target, anchors: Sequence[Mapping[str, str]]) -> Target:
        """Frames whose object the task itself has put in a fixed place relative to the chosen one, or the reverse.

        Of those, what the object rests upon is chosen: there it is to lie whatever becomes of the rest.
        """
        fixed = [anchors[number] for number in target.members]
        tied = {
            frame
            for frame in target.frames
            if frame != target.frame and all(a.get(frame, frame) == a.get(target.frame, target.frame) for a in fixed)
        }
        frame = target.upon[0] if target.upon else target.frame
        if frame not in tied or target.frames[frame] < LIKELY:
            return replace(target, tied=frozenset(tied))
        moved = self._target(target.members, frame, target.frames, target.context)
        return replace(moved, tied=frozenset(tied | {target.frame}) - {frame})

    def _anchors(self, targets: Sequence[Target]) -> list[dict[str, str]]:
        """For every move what each object was fixed to when it was released: alike for all that are rigid by the task.

        What is placed is fixed to what its frame is fixed to then; what goes elsewhere, to a spot of its own.
        """
        of = {number: target for target in targets for number in target.members}
        fixed: dict[int, dict[str, str]] = defaultdict(dict)
        found = []
        for number, move in enumerate(self.moves):
            found.append(dict(fixed[move.demonstration]))
            here, known = fixed[move.demonstration], of.get(number)
            if known or not move.put_back:
                here[move.object] = here.get(known.frame, known.frame) if known else f"move {number}"
        return found


def _worlds_after(demonstration: Demonstration, step: int, name: str) -> list[Mapping[str, Pose]]:
    """What was seen at each later press up to the next one on the object, and at the end if there is none."""
    worlds: list[Mapping[str, Pose]] = []
    for action in demonstration.actions[step + 1 :]:
        worlds.append(action.objects)
        if action.object == name:
            return worlds
    return [*worlds, demonstration.final]


def _offsets_in_base(frame: str, samples: Sequence[Sample]) -> Array:
    """The rests (n, 3) relative to a frame's origin [m], along the base's axes."""
    inside = [sample.rest(frame) for sample in samples]
    outside = np.array([sample.rest(sample.base_frame).quaternion_xyzw for sample in samples])
    frames = multiply(outside, conjugate(np.array([pose.quaternion_xyzw for pose in inside])))
    return rotate(frames, np.array([pose.position for pose in inside]))
