"""Many poses as a table: bit for bit what the same single poses give."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learner.errors import ModelError
from learner.model import Pose
from learner.model.poses import Poses

NUMBERS = st.floats(-2, 2)
QUATERNIONS = st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS).filter(lambda q: sum(v * v for v in q) > 1e-4)
POSES = st.lists(st.builds(Pose, st.tuples(NUMBERS, NUMBERS, NUMBERS), QUATERNIONS), min_size=2, max_size=6)


@settings(deadline=None)
@given(POSES)
def test_products_and_inverses_are_those_of_the_single_poses(poses: list[Pose]) -> None:
    table, others = Poses.of(poses), Poses.of(poses[::-1])
    products, inverses = table @ others, table.inverse()
    for row, (one, other) in enumerate(zip(poses, poses[::-1], strict=True)):
        assert products.pose(row) == one @ other
        assert inverses.pose(row) == one.inverse()


def test_what_is_not_known_stays_unknown_and_is_no_pose() -> None:
    table = Poses.joined([Poses.identity(1), Poses.unknown(1)])
    assert table.known.tolist() == (table @ table).known.tolist() == [True, False]
    with pytest.raises(ModelError):
        table.pose(1)


def test_rows_are_selected_and_joined() -> None:
    poses = [Pose((float(x), 0.0, 0.0)) for x in range(4)]
    table = Poses.of(poses)
    assert [table[[2, 0]].pose(row) for row in range(2)] == [poses[2], poses[0]]
    mixed = table.where(np.array([True, False, True, False]), Poses.identity(4))
    assert mixed.positions[:, 0].tolist() == [0, 0, 2, 0]


def test_every_row_at_once_is_the_pose_that_it_is_alone() -> None:
    rng = np.random.default_rng(4)
    poses = Poses(rng.normal(size=(50, 3)), rng.normal(size=(50, 4)))
    assert poses.each() == [poses.pose(row) for row in range(50)]


def test_a_row_that_is_not_known_is_refused_among_many_as_it_is_alone() -> None:
    poses = Poses.joined([Poses.identity(2), Poses.unknown(1)])
    with pytest.raises(ModelError, match="finite numbers"):
        poses.each()
    with pytest.raises(ModelError, match="no direction"):
        Poses(np.zeros((1, 3)), np.zeros((1, 4))).each()
