"""`treewright import`: other people's demonstrations become recordings of the cell `imported` (CONTRACT, section 4).

    DIR   the YAML demonstrations of matiov/learn-BTs-from-demo: a folder that holds info.yaml and demo1, demo2, ...
    BAG   a rosbag2 (folder, .mcap or .db3); --gripper names the topic that tells whether the gripper is open

With --json: {"imported": [file], "known": [file], "skipped": [{"file", "reason"}]}.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.console import Console
from pipelines.errors import CommandError
from pipelines.home import Home

if TYPE_CHECKING:
    from recorder.imports.yaml_import import Imported


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to import, whose demonstrations of what, and what is what in a bag."""
    parser.add_argument("source", metavar="DIR|BAG", help="a folder with info.yaml and demo1, ..., or a rosbag2")
    parser.add_argument("--task", required=True)
    parser.add_argument("--user", required=True)
    bag = parser.add_argument_group("of a rosbag2")
    bag.add_argument("--gripper", metavar="TOPIC", help="std_msgs/Bool, Float64 or sensor_msgs/JointState")
    bag.add_argument("--gripper-joint", metavar="NAME", help="the joint of a JointState that tells")
    bag.add_argument("--gripper-threshold", metavar="X", type=_number, help="between open and closed (the middle)")
    bag.add_argument("--gripper-closed", choices=("below", "above"), help="on which side it is closed (below)")
    bag.add_argument("--base", metavar="F", help="the base frame (base, base_link, world, ..., or the only root)")
    bag.add_argument("--end-effector", metavar="F", help="the end-effector's frame (tool0, tcp, ...)")
    bag.add_argument("--objects", metavar="PATTERN", nargs="+", help="frames of objects (all that are measured)")


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Write the recordings; a second time they are known."""
    done = _imported(arguments)
    for name, files in (("imported", done.imported), ("known", done.known)):
        for file in files:
            console.say(f"{name}: {file}")
    for skipped in done.skipped:
        console.say(f"skipped: {skipped.file}: {skipped.reason}")
    console.say(f"{len(done.imported)} imported, {len(done.known)} known, {len(done.skipped)} skipped")
    console.emit(
        {
            "imported": list(map(str, done.imported)),
            "known": list(map(str, done.known)),
            "skipped": [{"file": str(skipped.file), "reason": skipped.reason} for skipped in done.skipped],
        }
    )
    return 0


def _imported(arguments: argparse.Namespace) -> Imported:
    source, recordings = Path(arguments.source), Home.current().recordings
    if arguments.gripper is None and not _is_bag(source):
        from recorder.imports.yaml_import import import_folder

        return import_folder(source, recordings, arguments.task, arguments.user)
    from recorder.imports.bag_import import Wanted, import_bag, what_it_holds
    from recorder.imports.grippers import Meaning

    if arguments.gripper is None:
        raise CommandError(f"name the gripper's topic of {source} with --gripper; it holds {what_it_holds(source)}")
    meaning = Meaning(arguments.gripper_joint, arguments.gripper_threshold, arguments.gripper_closed)
    wanted = Wanted(
        arguments.task, arguments.user, arguments.gripper, arguments.base, arguments.end_effector,
        tuple(arguments.objects or ()), meaning,
    )  # fmt: skip
    return import_bag(source, recordings, wanted)


def _is_bag(source: Path) -> bool:
    return source.suffix in (".mcap", ".db3") or (source / "metadata.yaml").is_file()


def _number(text: str) -> float:
    import math

    number = float(text)
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{text!r} is no finite number")
    return number
