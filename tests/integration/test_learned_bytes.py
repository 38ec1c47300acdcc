"""The same demonstrations give the same bytes, however the lake holds them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support_demonstrations import Put, scattered, scripted

from learner.learning import METHODS, learn
from learner.model import Demonstration
from storage.lake import Lake


def shown() -> list[Demonstration]:
    rng = np.random.default_rng(4)
    script = [Put("A", "box", (0.0, 0.0, 0.02)), Put("B", "A", (0.0, 0.0, 0.05))]
    starts = [scattered(["A", "B", "box"], rng) for _ in range(6)]
    return [scripted(start, script, f"d{n}", user=f"u{n % 3}", rng=rng) for n, start in enumerate(starts)]


def learned_from(lake: Lake, method: str) -> tuple[str, str, str]:
    (task,) = {each.task for each in lake.demonstrations()}
    learned = learn(lake.demonstrations(task), method=method)
    return learned.tree.to_json(), json.dumps(learned.report), json.dumps(learned.notes)


@pytest.mark.parametrize("method", METHODS)
def test_a_lake_in_another_order_and_in_other_files_gives_the_same_bytes(method: str, tmp_path: Path) -> None:
    at_once, one_by_one, in_two = (Lake(tmp_path / name) for name in ("at_once", "one_by_one", "in_two"))
    demonstrations = shown()
    at_once.add_all(demonstrations)
    for each in reversed(demonstrations):
        one_by_one.add(each)
    in_two.add_all(demonstrations[3:])
    in_two.add_all(demonstrations[:3])
    in_two.compact()
    expected = learned_from(at_once, method)
    assert learned_from(one_by_one, method) == expected
    assert learned_from(in_two, method) == expected
