"""From targets to executable actions: one grasp an object, one placement a target, radii from spread and neighbours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np

from learner.inference.moves import Moves
from learner.inference.targets import Target
from learner.model import Demonstration, Drop, ObjectShape, Pick, Place, Pose, Scene
from learner.model.pose import Array
from learner.model.poses import Poses
from learner.model.scene import Symmetry
from learner.planning.grasps import Upright
from learner.planning.parameters import PlanningParameters
from learner.planning.rounding import rounded, rounded_pose, rounded_vector
from learner.planning.symmetry import agreeing_in_object, mean_in_object, mean_of_object, robust_mean, upright_axis
from learner.planning.turned import turned_at


class LearnedActions:
    """The actions of a task: `grasps` in each object's own frame, `placements` by target."""

    def __init__(self, moves: Moves, targets: Sequence[Target], parameters: PlanningParameters) -> None:
        self.moves, self.scene = moves, scene_of(moves.samples.demonstrations)
        self.parameters = parameters = parameters.for_cell(self.scene)
        self.picks = {str(name): moves.picks(moves.object == name) for name in np.unique(moves.object)}
        self.axes = {name: upright_axis(picks.origin(name)) for name, picks in self.picks.items()}
        self.grasps = {name: self._grasp(name) for name in self.axes}
        self.nearest_m = nearest_rests_m(moves, targets, parameters.same_rest_m)
        self.placements: Mapping[Target, Place | Drop] = {target: self._placement(target) for target in targets}

    def pick(self, name: str) -> Pick:
        """The mean grasp of an object, in its own frame."""
        grasp = rounded_pose(self.grasps[name])
        return Pick(name, name, grasp.position, grasp.quaternion_xyzw)

    def grasp_of(self, pick: Pick) -> Pose:
        """The end-effector's pose in the object's frame when it grasps as `pick` does."""
        return Pose(pick.position, pick.orientation)

    def _is_known(self, name: str) -> bool:
        """Whether a scene tells the object's shape: else nobody knows which turns of it look the same."""
        return self.scene is not None and name in self.scene.objects

    def _symmetry(self, name: str) -> Symmetry:
        return self._shape(name).symmetry

    def _shape(self, name: str) -> ObjectShape:
        unknown = ObjectShape((0.0, 0.0, 0.0))
        return self.scene.objects.get(name, unknown) if self.scene else unknown

    def _grasp(self, name: str) -> Pose:
        """As most picks of the object agree; where too few do, as those of all objects alike do together.

        How the hand is turned to the faces is the operator's habit and the gripper's, not the object's: markers that
        flip or come late must not decide it where other objects tell better. Where the hand is beside the origin is
        the object's own, unless too few of its picks agree with what was pooled.
        """
        own, alike = self._demonstrated(name), [self._demonstrated(other) for other in self._alike(name)]
        mean, least = self._mean(name, own), self.parameters.min_samples
        if not alike or len(self._agreeing(name, own, mean)) >= max(least, len(own) // 2 + 1):
            return mean
        pooled = self._mean(name, Poses.joined([own, *alike]))
        agreeing = self._agreeing(name, own, pooled)
        return self._mean(name, agreeing) if len(agreeing) >= min(least, len(own)) else pooled

    def _demonstrated(self, name: str) -> Poses:
        """The end-effector's poses in the object's frame at its picks."""
        return self.picks[name].target(name)

    def _alike(self, name: str) -> list[str]:
        """The other picked objects that have the same known shape and stand on the same axis."""
        known = self.scene.objects if self.scene else {}
        return [
            other
            for other, axis in self.axes.items()
            if other != name
            and name in known
            and known.get(other) == known[name]
            and np.array_equal(axis, self.axes[name])
        ]

    def _mean(self, name: str, grasps: Poses) -> Pose:
        return mean_in_object(grasps, self._symmetry(name), self.axes[name], self.parameters.means)

    def _agreeing(self, name: str, grasps: Poses, mean: Pose) -> Poses:
        orientation = np.array(mean.quaternion_xyzw)
        symmetry, axis = self._symmetry(name), self.axes[name]
        return agreeing_in_object(grasps, orientation, symmetry, axis, self.parameters.means)

    def _placement(self, target: Target) -> Place | Drop:
        name, p = target.object, self.parameters
        axis, symmetry = self.axes[name], self._symmetry(name)
        release = mean_of_object(target.releases, symmetry, axis, p.means)
        if target.label.corrected and target.type == "place":
            release = self._lowered(target, release)
        hand = rounded_pose(release @ self.grasps[name])
        rest = rounded_vector(self._rest(target))
        if target.type == "place":
            turned = turned_at(target, self.moves, symmetry, axis, p) if self._is_known(name) else None
            radius = self._place_radius(target)
            return Place(name, target.frame, hand.position, hand.quaternion_xyzw, rest, radius, turned)
        return Drop(name, target.frame, hand.position, hand.quaternion_xyzw, rest, self._drop_radius(target))

    def _rest(self, target: Target) -> Array:
        """Where (3,) the object came to rest, in the frame of the target."""
        return robust_mean(target.rests.positions, self.parameters.means)

    def _lowered(self, target: Target, release: Pose) -> Pose:
        """The release brought down to just above the rest: what was dropped upon something is placed upon it."""
        rest = self._rest(target)
        fall = np.array(release.position) - rest
        height = float(np.linalg.norm(fall))
        return Pose.of(
            rest + fall * min(1.0, self.parameters.release_clearance_m / max(height, 1e-9)), release.quaternion_xyzw
        )

    def _place_radius(self, target: Target) -> float:
        """As noise and the spread of the rests ask for, and less where it must be told from what is near."""
        p, seen_m = self.parameters, self.parameters.sigmas_seen * self._seen_m(target)
        wide = float(np.hypot(p.noise_radius_m, p.spread_radii * self._scatter_m(target)))
        usual = max(p.least_radius_m, seen_m, min(wide, p.below_lowest * self._lowest_m()))
        apart = min(p.apart * self.nearest_m.get(target, np.inf), p.below_lowest * self.pocket_m(target))
        return rounded(min(p.place_radius_m, max(seen_m, min(usual, apart))))

    def _scatter_m(self, target: Target) -> float:
        """How much more the rests scatter per axis [m] than a cell's own noise explains; 0 of too few to tell."""
        rests, p = target.rests.positions, self.parameters
        if len(rests) < p.min_samples:
            return 0.0
        variance = float(((rests - rests.mean(axis=0)) ** 2).sum() / (3 * (len(rests) - 1)))
        return float(np.sqrt(max(variance - self._seen_m(target) ** 2, 0.0)))

    def _seen_m(self, target: Target) -> float:
        """The scatter [m] per axis of what a camera sees of an object in a frame that it sees turned, too."""
        if target.frame == self.moves.samples.base:
            return self.parameters.seen_m
        lever_m = float(np.linalg.norm(np.median(target.rests.positions, axis=0)))
        return float(np.hypot(np.sqrt(2) * self.parameters.seen_m, self.parameters.seen_rad * lever_m))

    def pocket_m(self, target: Target) -> float:
        """How deep [m] the object comes to lie below the top of that of the frame, which is no open container.

        Infinite where it does not, or where no scene tells. So much higher it would lie upon the rim.
        """
        known = self.scene.objects if self.scene else {}
        if not {target.object, target.frame} <= set(known) or known[target.frame].open:
            return math.inf
        heights_m = (self._height_m(target, name) for name in (target.frame, target.object))
        deep_m = sum(heights_m) / 2 - self._raised_m(target)
        return deep_m if deep_m > self.parameters.sunk_sigmas * self.parameters.seen_m else math.inf

    def _height_m(self, target: Target, name: str) -> float:
        """The height [m] of an object of known shape as it stands when the target's is released."""
        assert self.scene is not None
        poses = self.moves.releases(target.members).origin(name)
        return Upright(self.scene.objects[name], upright_axis(poses[poses.known])).height_m

    def _raised_m(self, target: Target) -> float:
        """How much higher [m] than the frame's the object's origin comes to rest."""
        releases = self.moves.releases(target.members)
        heights = releases.rest(self.moves.samples.base).positions - releases.origin(target.frame).positions
        return float(np.nanmedian(heights[:, 2]))

    def _lowest_m(self) -> float:
        """The height [m] of the lowest object that is picked, as it stands; infinite where no scene tells it."""
        known = self.scene.objects if self.scene else {}
        heights = (Upright(known[name], axis).height_m for name, axis in self.axes.items() if name in known)
        return min(heights, default=np.inf)

    def _drop_radius(self, target: Target) -> float:
        """The paper's, but not wider than the container dropped into, where its shape is known."""
        p, shape = self.parameters, self._shape(target.frame)
        rest = self._rest(target)
        sides = sorted(shape.size_m)[1:]
        inside = min(sides) / 2 if min(sides) > 0 else np.inf
        contained = inside if np.linalg.norm(rest) < max(shape.size_m) / 2 else np.inf
        apart = p.apart * self.nearest_m.get(target, np.inf)
        narrow = min(contained, max(apart, p.place_radius_m))
        return rounded(min(p.drop_radius_m, max(p.least_radius_m, narrow)))


def scene_of(demonstrations: Sequence[Demonstration]) -> Scene | None:
    """The newest scene that a demonstration carries; None if none does."""
    known = [demonstration for demonstration in demonstrations if demonstration.scene]
    newest = max(known, key=lambda d: (d.start_ns or 0, d.demonstration_id), default=None)
    return newest.scene if newest else None


def nearest_rests_m(moves: Moves, targets: Sequence[Target], same_m: float) -> Mapping[Target, float]:
    """For each target the distance [m] to the nearest other target reached in one demonstration, in the base.

    The median over demonstrations of the distance between rests. Targets that are never reached in one
    demonstration do not count, nor do equal places, which are nearer than `same_m` [m], and one of which was left.
    """
    count = len(moves.samples.demonstrations)
    rests = [_rests_in_base(target, moves, count) for target in targets]
    stays = [_stays(target, moves) for target in targets]
    nearest: dict[Target, float] = {}
    for (a, at_a, stays_a), (b, at_b, stays_b) in permutations(zip(targets, rests, stays, strict=True), 2):
        apart = np.linalg.norm(at_a - at_b, axis=1)
        both = apart[~np.isnan(apart)]
        middle = float(np.median(both)) if len(both) else 0.0
        if len(both) and (middle > same_m or (stays_a and stays_b and a.object != b.object)):
            nearest[a] = min(middle, nearest.get(a, np.inf))
    return nearest


def _stays(target: Target, moves: Moves) -> bool:
    """Whether most demonstrations that reach a target leave its object there."""
    own = np.flatnonzero(moves.object == target.object)
    last = dict(zip(moves.demonstration[own].tolist(), own.tolist(), strict=True))
    left = [number for number in target.members if last[int(moves.demonstration[number])] != number]
    return 2 * len(left) < len(target.members)


def _rests_in_base(target: Target, moves: Moves, count: int) -> Array:
    """Where the object came to rest at a target in each demonstration (count, 3), the last time; NaN for never."""
    found, members = np.full((count, 3), np.nan), list(target.members)
    found[moves.demonstration[members]] = moves.releases(members).rest(moves.samples.base).positions
    return found
