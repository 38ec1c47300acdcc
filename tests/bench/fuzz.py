"""10 000 mutated recordings and 10 000 mutated requests to the recorder: how many get which answer."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from support_fuzz import Answers, requests, try_files
from support_recorder import CELL, START, recording_cell
from support_recordings import object_in_box

COUNT = 10_000


def main() -> None:
    """Print the answers by kind."""
    with tempfile.TemporaryDirectory() as folder:
        begun_s = time.perf_counter()
        answers = try_files(object_in_box(1).write(Path(folder) / "whole.mcap"), Path(folder), COUNT, seed=1)
        _tell("files", answers, time.perf_counter() - begun_s)
    with tempfile.TemporaryDirectory() as folder:
        begun_s, answers = time.perf_counter(), Answers()
        with recording_cell(Path(folder)) as cell:
            templates = {"start": START, "stop": {"outcome": "success"}, "press": {"type": "pick", "object": "A"}}
            for number, (verb, template) in enumerate(templates.items()):
                for payload in requests(template, COUNT // len(templates), seed=number):
                    replies = list(
                        cell.session.get(f"treewright/{CELL}/recorder/{verb}", payload=payload, timeout=20.0)
                    )
                    for reply in replies:
                        said = json.loads(reply.err.payload.to_bytes())["error"] if reply.err is not None else ""
                        answers.add("refused" if said else "answered", said)
                    answers.wrong += [] if replies else [f"no answer to {payload[:80]!r}"]
        _tell("requests", answers, time.perf_counter() - begun_s)


def _tell(what: str, answers: Answers, duration_s: float) -> None:
    print(f"{what}: {dict(answers.kinds.most_common())}; wrong {len(answers.wrong)}; {duration_s:.0f} s")
    for sentence in sorted(set(answers.wrong))[:20]:
        print(f"  {sentence}")
