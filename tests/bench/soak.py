"""An hour's worth of messages with random faults: how many were recorded, lost and counted, and lost uncounted."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

SOAKS, ROUNDS = 6, 40
HOUR_MESSAGES = 3600 * (30 + 1 + 1)
"""A cell's poses at 30 Hz, its gripper and one more topic at 1 Hz."""


def main() -> dict[str, Any]:
    """Soak, print, and return the figures; raises AssertionError if a loss was not counted."""
    sys.path.insert(0, str(Path(__file__).parents[1]))  # the tests' support modules
    from support_soak import soak

    begun_s, published, recorded, lost = time.monotonic(), 0, 0, 0
    faults: dict[str, int] = {}
    for seed in range(SOAKS):
        with tempfile.TemporaryDirectory(prefix="treewright-soak-") as folder:
            result = soak(Path(folder), ROUNDS, np.random.default_rng(seed))
        assert not any(result.uncounted.values()), f"seed {seed}: uncounted {result.uncounted} in {result}"
        assert not result.repeated, f"seed {seed}: {result.repeated} messages were recorded twice"
        published += sum(result.published.values())
        recorded += sum(result.recorded.values())
        lost += sum(count or 0 for count in result.lost.values())
        for fault, count in result.faults.items():
            faults[fault] = faults.get(fault, 0) + count
    print(f"{published} messages ({published / HOUR_MESSAGES:.1f} h of a cell's) in {time.monotonic() - begun_s:.0f} s")
    print(f"recorded {recorded}, lost and counted {lost}, lost and not counted 0; faults: {faults}")
    return {"published": published, "recorded": recorded, "lost": lost, "faults": faults}
