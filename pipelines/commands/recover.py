"""`treewright recover`: complete a torn or damaged recording from what is whole in it."""

from __future__ import annotations

import argparse
from pathlib import Path

from pipelines.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The torn file, and where the completed one goes."""
    parser.add_argument("file", metavar="FILE", type=Path, help="the torn recording; it is left as it is")
    parser.add_argument(
        "-o", "--output", metavar="FILE", type=Path, help="default: its name without .part, or NAME-recovered.mcap"
    )


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Write what is whole. `--json`: `file`, `messages` by topic, `sha256`, `cut_bytes`, `gone`: sentences."""
    from recorder.recovery import recover

    torn = arguments.file.absolute()
    done = recover(torn, (arguments.output or _beside(torn)).absolute())
    total = sum(done.finished.messages.values())
    console.say(
        f"{done.finished.file}: {total} messages saved, {done.cut_bytes} bytes at the torn end were no whole chunk"
    )
    for sentence in done.gone:
        console.say(f"gone: {sentence}")
    console.emit(
        {
            "file": str(done.finished.file),
            "messages": dict(done.finished.messages),
            "sha256": done.finished.sha256,
            "cut_bytes": done.cut_bytes,
            "gone": list(done.gone),
        }
    )
    return 0


def _beside(torn: Path) -> Path:
    from recorder.recording import UNFINISHED

    if torn.name.endswith(UNFINISHED):
        return torn.with_name(torn.name.removesuffix(UNFINISHED))
    return torn.with_name(f"{torn.name.removesuffix('.mcap')}-recovered.mcap")
