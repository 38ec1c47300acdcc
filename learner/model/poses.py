"""Many poses as two arrays: the algebra of `learner.model.pose.Pose`, bit for bit, on all of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learner.model.pose import IDENTITY_XYZW, Array, Pose, conjugate, multiply, rotate

Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Poses:
    """`positions` [m] (n, 3) and unit `quaternions_xyzw` (n, 4); NaN in a row whose pose is not known."""

    positions: Array
    quaternions_xyzw: Array

    @staticmethod
    def of(poses: Sequence[Pose]) -> Poses:
        """The table of these poses."""
        return Poses.from_rows([(*pose.position, *pose.quaternion_xyzw) for pose in poses])

    @staticmethod
    def from_rows(rows: Sequence[Sequence[float]] | Array) -> Poses:
        """From rows of three coordinates [m] and a unit quaternion xyzw, (n, 7)."""
        table = np.asarray(rows, dtype=np.float64).reshape(-1, 7)
        return Poses(np.ascontiguousarray(table[:, :3]), np.ascontiguousarray(table[:, 3:]))

    @staticmethod
    def identity(count: int) -> Poses:
        """So many times the origin."""
        return Poses(np.zeros((count, 3)), np.tile(np.array(IDENTITY_XYZW), (count, 1)))

    @staticmethod
    def unknown(count: int) -> Poses:
        """So many poses that are not known."""
        return Poses(np.full((count, 3), np.nan), np.full((count, 4), np.nan))

    @staticmethod
    def joined(tables: Sequence[Poses]) -> Poses:
        """The rows of several tables, one after the other."""
        quaternions = np.concatenate([table.quaternions_xyzw for table in tables])
        return Poses(np.concatenate([table.positions for table in tables]), quaternions)

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, rows: Any) -> Poses:
        """The poses of some rows: an array of numbers, a mask (n,) or a slice."""
        return Poses(self.positions[rows], self.quaternions_xyzw[rows])

    @property
    def known(self) -> Mask:
        """Which rows (n,) hold a pose."""
        return np.asarray(~np.isnan(self.positions[:, 0]))

    def pose(self, row: int) -> Pose:
        """One row. Raises ModelError where it is not known."""
        return Pose.of(self.positions[row], self.quaternions_xyzw[row])

    def each(self) -> list[Pose]:
        """Every row. Raises ModelError where one is not known; many times faster than row by row."""
        good = np.isfinite(self.positions).all(axis=1) & np.isfinite(self.quaternions_xyzw).all(axis=1)
        good &= np.linalg.norm(self.quaternions_xyzw, axis=1) > 1e-6
        if not good.all():
            self.pose(int(np.argmin(good)))
        units = _normalised(self.positions, self.quaternions_xyzw)
        rows = zip(units.positions.tolist(), units.quaternions_xyzw.tolist(), strict=True)
        return [Pose.unchecked(tuple(position), tuple(quaternion)) for position, quaternion in rows]

    def where(self, mask: Mask, others: Poses) -> Poses:
        """The own rows where `mask` (n,) holds, elsewhere those of `others`."""
        positions = np.where(mask[:, None], self.positions, others.positions)
        return Poses(positions, np.where(mask[:, None], self.quaternions_xyzw, others.quaternions_xyzw))

    def __matmul__(self, other: Poses) -> Poses:
        """Row by row: `poses_a_in_base @ poses_b_in_a` is `poses_b_in_base`."""
        positions = self.positions + rotate(self.quaternions_xyzw, other.positions)
        return _normalised(positions, multiply(self.quaternions_xyzw, other.quaternions_xyzw))

    def inverse(self) -> Poses:
        """Row by row: `poses_a_in_base.inverse()` is `poses_base_in_a`."""
        quaternions = conjugate(self.quaternions_xyzw)
        return _normalised(-rotate(quaternions, self.positions), quaternions)


def _normalised(positions: Array, quaternions: Array) -> Poses:
    """With unit quaternions, as `Pose` makes them: one that is a unit to 1e-12 stays as it is."""
    x, y, z, w = quaternions.T
    norms = np.sqrt(x * x + y * y + z * z + w * w)[:, None]
    return Poses(positions, np.where(np.abs(norms - 1.0) > 1e-12, quaternions / norms, quaternions))
