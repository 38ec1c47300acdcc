"""`treewright record`: the recorder daemon of a cell, until SIGINT or SIGTERM."""

from __future__ import annotations

import argparse
import os
import signal
import threading
from typing import TYPE_CHECKING, Any

from pipelines.console import Console
from pipelines.errors import CommandError
from pipelines.home import TOKEN, Home
from pipelines.network.session import add_zenoh_arguments, open_session
from pipelines.options import MEGABYTES, add_profile_argument, real, seconds

if TYPE_CHECKING:
    from pipelines.profile import Profile
    from recorder.upload.carrier import Destination


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `record`."""
    parser.add_argument("--cell", required=True, help="the cell to record")
    parser.add_argument(
        "--pre-roll",
        type=seconds(least=0, most=600),
        default=2.0,
        metavar="S",
        help="poses before a start [s] (default 2)",
    )
    parser.add_argument("--include", action="append", default=[], metavar="KEY", help="record only such other keys")
    parser.add_argument("--exclude", action="append", default=[], metavar="KEY", help="do not record such other keys")
    parser.add_argument(
        "--split-mb", type=real(least=0.01, most=1 << 20), metavar="MB", help="then go on in another file"
    )
    parser.add_argument("--split-s", type=seconds(least=0.1), metavar="S", help="then go on in another file")
    parser.add_argument(
        "--buffer-mb",
        type=MEGABYTES,
        default=256,
        metavar="MB",
        help="memory while the disk is slow",
    )
    parser.add_argument(
        "--upload",
        metavar="URL",
        help="bring finished recordings to a service (default TREEWRIGHT_UPLOAD_URL); its token is TREEWRIGHT_TOKEN",
    )
    add_profile_argument(parser)
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Serve until told to end; an open recording is then closed durably with outcome `unknown`."""
    from learner.model import check_name
    from pipelines.profile import profile_of
    from recorder.daemon import Recorder

    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    home, cell = Home.current(), check_name("cell", arguments.cell)
    folder, profile = home.recordings / cell, profile_of(cell, home, arguments.profile)
    with (
        open_session(arguments) as session,
        Recorder(session, cell, folder, _options(arguments, profile), lambda event: _show(console, event)),
    ):
        console.emit({"ready": True})
        knows = f", which has {', '.join(profile.objects)}," if profile else ""
        console.say(f"recording for the cell {cell}{knows} into {folder}; end with Ctrl-C")
        ended.wait()
    return 0


def _options(arguments: argparse.Namespace, profile: Profile | None) -> Any:
    from recorder.daemon import Options
    from recorder.intake.patterns import Patterns

    return Options(
        pre_roll_s=arguments.pre_roll,
        buffer_bytes=int(arguments.buffer_mb * (1 << 20)),
        split_bytes=None if arguments.split_mb is None else int(arguments.split_mb * (1 << 20)),
        split_s=arguments.split_s,
        patterns=Patterns(arguments.include, arguments.exclude),
        upload_to=_destination(arguments.upload or os.environ.get("TREEWRIGHT_UPLOAD_URL")),
        cell={} if profile is None else profile.start(),
    )


def _destination(url: str | None) -> Destination | None:
    from recorder.upload.carrier import Destination

    if not url:
        return None
    token = os.environ.get(TOKEN)
    if not token:
        raise CommandError(f"the service at {url} takes recordings with its token alone; set {TOKEN}")
    return Destination(url, token)


def _show(console: Console, event: dict[str, Any]) -> None:
    console.emit(event)
    details = {name: value for name, value in event.items() if name not in ("stamp_ns", "event")}
    console.say(f"{event['event']}: " + ", ".join(f"{name} {value}" for name, value in details.items()))
