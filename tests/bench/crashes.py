"""kill -9 at two hundred random moments: nothing durable is gone, and how much of the streams a crash costs."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

LIVES = 200
GOAL_S = 0.2


def main() -> dict[str, Any]:
    """Kill, recover, print, and return the figures; raises AssertionError if anything durable is gone."""
    sys.path.insert(0, str(Path(__file__).parents[1]))  # the tests' support modules
    from support_killed_recorder import live_and_die

    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory(prefix="treewright-crashes-") as folder:
        lives = [live_and_die(Path(folder) / str(life), rng) for life in range(LIVES)]
    missing_s = np.array([life.missing_s for life in lives])
    durable = sum(life.durable for life in lives)
    print(f"{LIVES} kills: {durable} durable actions, all read back with their poses")
    print(
        f"missing at the end of the streams: median {np.median(missing_s) * 1e3:.0f} ms, "
        f"99 % {np.quantile(missing_s, 0.99) * 1e3:.0f} ms, most {missing_s.max() * 1e3:.0f} ms; "
        f"within the goal of {GOAL_S * 1e3:.0f} ms: {np.mean(missing_s <= GOAL_S):.1%}"
    )
    return {"durable": durable, "missing_s": missing_s.tolist()}
