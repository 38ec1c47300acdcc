"""Writers that are killed in the middle: the lake and the store keep only whole things."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from support_demonstrations import demonstration

from storage.artifacts import ArtifactStore
from storage.lake import Lake

COUNT = 8
ADDS = """
import sys
from pathlib import Path
from support_demonstrations import demonstration
from storage.lake import Lake

lake = Lake(Path(sys.argv[1]))
print("ready", flush=True)
for number in range(int(sys.argv[2])):
    lake.add(demonstration(f"d{number:02}"))
"""
PUBLISHES = """
import sys
from pathlib import Path
from learner.model import SetGripper, Tree
from learner.model.tree import Definition, leaf, sequence
from storage.artifacts import ArtifactStore

store = ArtifactStore(Path(sys.argv[1]))
print("ready", flush=True)
for number in range(1, int(sys.argv[2]) + 1):
    tree = Tree(Definition("Main", sequence(*[leaf(SetGripper("open"))] * number)))
    store.alias("task", "latest", store.publish("task", tree, {}).version)
"""


def start(script: str, root: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(root), str(COUNT)],
        stdout=subprocess.PIPE,
        text=True,
        env={"PYTHONPATH": str(Path(__file__).parents[1])},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def kill_at_random(script: str, root: Path, rng: np.random.Generator) -> None:
    with start(script, root) as process:
        time.sleep(rng.uniform(0.0, 0.6))
        process.send_signal(signal.SIGKILL)


def test_an_ingest_killed_at_any_moment_leaves_whole_demonstrations_and_completes(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    wanted = [demonstration(f"d{number:02}") for number in range(COUNT)]
    for _ in range(3):
        kill_at_random(ADDS, tmp_path / "lake", rng)
        found = Lake(tmp_path / "lake").demonstrations()
        assert found == wanted[: len(found)]
    with start(ADDS, tmp_path / "lake") as process:
        assert process.wait(timeout=120) == 0
    assert Lake(tmp_path / "lake").demonstrations() == wanted


def test_a_publisher_killed_at_any_moment_leaves_whole_versions_and_completes(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    for _ in range(3):
        kill_at_random(PUBLISHES, tmp_path / "store", rng)
        with ArtifactStore(tmp_path / "store") as store:
            for row in store.tasks():
                for version in range(1, row["version"] + 1):
                    assert store.verify("task", version).tree.nodes == version + 1
    with start(PUBLISHES, tmp_path / "store") as process:
        assert process.wait(timeout=120) == 0
    with ArtifactStore(tmp_path / "store") as store:
        assert store.aliases("task") == {"latest": COUNT}
        assert store.verify("task").tree.nodes == COUNT + 1
