"""What the cell's camera makes of the true poses, and the steadier estimate that its skills work with."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from learner.model import Pose
from learner.model.pose import angle_between, mean_quaternion, multiply

SAMPLES: Final = 9
"""Observations that an estimate usually averages, if the object stood still over them."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations per axis: of a position [m] and of a rotation vector [rad]."""

    position_m: float = 0.0015
    rotation_rad: float = math.radians(0.3)

    def disturb(self, poses: Sequence[Pose], rng: np.random.Generator) -> list[Pose]:
        """`poses` as a camera with this noise sees them once."""
        vectors = rng.normal(0.0, self.rotation_rad, (len(poses), 3))
        angles = np.linalg.norm(vectors, axis=1, keepdims=True)
        turns = np.concatenate([0.5 * vectors * np.sinc(angles / (2 * math.pi)), np.cos(angles / 2)], axis=1)
        shaken = multiply(turns, np.array([pose.quaternion_xyzw for pose in poses]))
        positions = np.array([pose.position for pose in poses]) + rng.normal(0.0, self.position_m, (len(poses), 3))
        return [Pose.of(*each) for each in zip(positions.tolist(), shaken.tolist(), strict=True)]


class Camera:
    """Sees every object, each time anew with noise; an estimate averages the last `samples` looks."""

    def __init__(self, noise: Noise, rng: np.random.Generator, samples: int = SAMPLES) -> None:
        self.noise, self._rng, self._samples = noise, rng, samples
        self._seen: dict[str, deque[Pose]] = {}

    def observe(self, true_poses: Mapping[str, Pose]) -> dict[str, Pose]:
        """One noisy look at the true poses in the base."""
        if not true_poses:
            return {}
        seen = dict(zip(true_poses, self.noise.disturb(list(true_poses.values()), self._rng), strict=True))
        for name, pose in seen.items():
            self._seen.setdefault(name, deque(maxlen=self._samples)).append(pose)
        return seen

    def forget(self) -> None:
        """Begin anew: what was seen is no longer there."""
        self._seen.clear()

    def estimate(self, name: str) -> Pose | None:
        """The mean of the last looks that agree with the newest; None if the object was never seen."""
        if name not in self._seen:
            return None
        poses = list(self._seen[name])
        positions = np.array([pose.position for pose in poses])
        quaternions = np.array([pose.quaternion_xyzw for pose in poses])
        near_m, near_rad = max(0.005, 4 * self.noise.position_m), max(0.02, 5 * self.noise.rotation_rad)
        agree = np.linalg.norm(positions - positions[-1], axis=1) < near_m
        agree &= angle_between(quaternions, quaternions[-1]) < near_rad
        return Pose.of(positions[agree].mean(axis=0), mean_quaternion(quaternions[agree]))
