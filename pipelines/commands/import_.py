"""`treewright import`: YAML demonstrations of matiov/learn-BTs-from-demo become recordings."""

from __future__ import annotations

import argparse

from pipelines.console import Console
from pipelines.home import Home


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The folder, and whose demonstrations of what it holds."""
    parser.add_argument("directory", metavar="DIR", help="the folder that holds info.yaml and demo1, demo2, ...")
    parser.add_argument("--task", required=True)
    parser.add_argument("--user", required=True)


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Write the recordings; a second time they are known. `--json`: `imported`, `known`, `skipped` with reasons."""
    from pathlib import Path

    from recorder.yaml_import import import_folder

    done = import_folder(Path(arguments.directory), Home.current().recordings, arguments.task, arguments.user)
    for name, files in (("imported", done.imported), ("known", done.known)):
        for file in files:
            console.say(f"{name}: {file}")
    for skipped in done.skipped:
        console.say(f"skipped: {skipped.file}: {skipped.reason}")
    console.say(f"{len(done.imported)} imported, {len(done.known)} known, {len(done.skipped)} files skipped")
    console.emit(
        {
            "imported": list(map(str, done.imported)),
            "known": list(map(str, done.known)),
            "skipped": [{"file": str(skipped.file), "reason": skipped.reason} for skipped in done.skipped],
        }
    )
    return 0
