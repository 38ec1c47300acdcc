"""From stop to tree: how long after the operator pressed stop the tree is served, the services warm, and its parts."""

from __future__ import annotations

import argparse
import json
import socket
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from statistics import median
from typing import Any

TASKS = 5
DEMONSTRATIONS = 3
GOAL_S = 5.0
PAUSE_S = 5.0
"""Between two demonstrations; an operator needs longer to show the next one."""


def main() -> dict[str, Any]:
    """Record demonstrations as a recorder does, and time the last of each task; print and return the figures."""
    sys.path.insert(0, str(Path(__file__).parents[1]))  # the tests' support modules
    from support_processes import daemon

    with tempfile.TemporaryDirectory(prefix="treewright-bench-") as folder, socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        probe.close()
        begun_s = time.monotonic()
        options = ("--http", "127.0.0.1:0", "--prefect-port", "0", "--period", "3600", "--listen", endpoint)
        with daemon(Path(folder), "serve", *options) as process:
            process.hear(600)
            warm_s, serving = time.monotonic() - begun_s, process.hear(60)
            taken_s = [_shown(process, Path(folder), endpoint, f"task{number}") for number in range(TASKS)]
            time.sleep(2.0)  # the artifacts come after the tree
            parts = [_parts(serving["prefect"], f"task{number}") for number in range(TASKS)]
    stages = {stage: median(each[stage] for each in parts) for stage in parts[0]}
    figures = {"warm_s": warm_s, "stop_to_tree_s": median(taken_s), "stages_s": stages}
    print(f"warm after {warm_s:.1f} s; from stop to tree, {DEMONSTRATIONS} demonstrations, {TASKS} tasks:")
    print(f"median {median(taken_s):.2f} s (goal {GOAL_S:g} s), least {min(taken_s):.2f} s, most {max(taken_s):.2f} s")
    print("of it: " + ", ".join(f"{stage} {spent_s * 1e3:.0f} ms" for stage, spent_s in stages.items()))
    return figures


def _shown(process: Any, home: Path, endpoint: str, task: str) -> float:
    """Show a task; the seconds from the last demonstration's stop to its tree."""
    from support_recordings import object_in_box

    from pipelines.network.session import open_session

    network = argparse.Namespace(connect=[endpoint], listen=None, zenoh_config=None)
    with open_session(network, {}) as session:
        for seed in range(DEMONSTRATIONS):
            time.sleep(PAUSE_S)
            file = object_in_box(seed, task).write(home / "recordings" / "bench" / f"{task}-{seed}.mcap")
            begun_s = time.monotonic()
            session.put("treewright/bench/recorder/events", json.dumps({"event": "stop", "file": str(file)}))
            while process.hear(300)["event"] != "alias":
                pass
    return time.monotonic() - begun_s


def _parts(prefect: str, task: str) -> dict[str, float]:
    """How long each stage took, by what the flow shows."""
    wanted = {"artifacts": {"key": {"any_": [f"timings-{task}"]}}}
    headers = {"Content-Type": "application/json"}
    request = urllib.request.Request(f"{prefect}/artifacts/latest/filter", json.dumps(wanted).encode(), headers)
    with urllib.request.urlopen(request, timeout=60) as response:
        (artifact,) = json.loads(response.read())
    return {row["stage"]: row["seconds"] for row in json.loads(artifact["data"])}
