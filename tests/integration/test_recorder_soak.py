"""Random faults, the short form; the long one is in the benchmarks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support_soak import soak


def test_random_faults_lose_nothing_that_is_not_counted(tmp_path: Path) -> None:
    result = soak(tmp_path, rounds=12, rng=np.random.default_rng(4))
    assert result.uncounted == {"/force": 0, "/image": 0, "/state": 0}, result
    assert result.repeated == 0
    assert result.recorded["/force"] > 1_000
    assert len(result.faults) >= 4
