"""`treewright demo`: the whole line on a simulated cell, each part a process of its own; ends with a report.

With --json the report: {"success", "seconds", "tree", "runs", "files"}. Exits 1 if the robot failed, by the world's
truth.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pipelines.console import Console
from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.options import SEED, SPEED, whole

if TYPE_CHECKING:
    from pipelines.demo.demo import Report

FOLDER: Final = "treewright-demo"
MARK: Final = "demo.txt"
"""Stands in a folder that a demo made, which alone a later demo may replace."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright demo`."""
    parser.add_argument("--home", type=Path, metavar="DIR", help=f"folder of the demo (default ./{FOLDER})")
    parser.add_argument("--keep", action="store_true", help="keep the folder of an earlier demo; this one goes beside")
    parser.add_argument(
        "--demonstrations", type=whole(1, 100), default=3, metavar="N", help="how many are shown (default 3)"
    )
    parser.add_argument("--seed", type=SEED, default=1, metavar="N", help="of everything random (default 1)")
    parser.add_argument(
        "--speed",
        type=SPEED,
        default=3.0,
        metavar="X",
        help="the cell's time, in units of the wall's",
    )


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0 if the robot did the task in every run."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    home = Home(_folder(arguments, os.environ))
    from pipelines.demo.demo import Settings, demo

    report = demo(home, Settings(arguments.demonstrations, arguments.seed, arguments.speed), console.say)
    return conclude(report, console)


def conclude(report: Report, console: Console) -> int:
    """Show the report; 0 if every run reached the goal, else 1 after one line on standard error."""
    console.emit(report.to_data())
    _tell(report, console)
    if not report.success:
        failed = ", ".join(run.name for run in report.runs if not run.success)
        traces = Path(report.runs[0].trace).parent
        console.warn(f"the robot did not reach the goal when run {failed}; the traces in {traces} tell what it did")
    return 0 if report.success else 1


def _folder(arguments: argparse.Namespace, environment: Mapping[str, str]) -> Path:
    """An empty folder for this demo. Raises CommandError for one that holds what no demo made."""
    root = environment.get("TREEWRIGHT_HOME")
    chosen: Path = arguments.home or (Path(root) / "demo" if root else Path(FOLDER))
    folder = _free_name(chosen.absolute()) if arguments.keep else chosen.absolute()
    if folder.exists() and any(folder.iterdir()):
        if not (folder / MARK).exists():
            raise CommandError(f"{folder} holds something that no demo made; name another folder with --home")
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MARK).write_text("Made by `treewright demo`; the next one replaces this folder.\n")
    return folder


def _free_name(folder: Path) -> Path:
    names = (folder.with_name(f"{folder.name}-{number}" if number > 1 else folder.name) for number in range(1, 10_000))
    return next(name for name in names if not name.exists())


def _tell(report: Report, console: Console) -> None:
    tree, files = report.tree, report.files
    done = sum(run.success for run in report.runs)
    console.say("")
    console.say(f"{done} of {len(report.runs)} runs reached the goal, by the world's truth, in {report.seconds:g} s")
    recovery = f"{tree['nodes_recovery']} more that only recover, {tree['nodes_written']} written"
    console.say(f"tree        {tree['task']}@{tree['version']}: {tree['nodes']} nodes ({recovery})")
    console.say(f"picture     {files['picture']}")
    console.say(f"XML         {files['xml']}")
    console.say(f"recordings  {Path(files['recordings'][0]).parent}")
    console.say(f"lake        {files['lake']}")
    console.say(f"store       {files['store']}")
    console.say(f"traces      {Path(files['traces'][0]).parent}")
    console.say(f"logs        {files['logs']}")
    console.say(f"flows       TREEWRIGHT_HOME={files['home']} treewright serve   shows Prefect's pages again")
