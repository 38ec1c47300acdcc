"""`treewright sim`: a simulated cell lives on Zenoh until it is told to stop."""

from __future__ import annotations

import argparse
import signal
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pipelines.commands.options import SEED, SPEED, real
from pipelines.console import Console, silent_standard_error
from pipelines.network.session import add_zenoh_arguments, open_session

if TYPE_CHECKING:
    import zenoh

SCENARIOS = ("object_in_box", "towers", "tower_and_box", "kitting", "hanoi")
"""Those of `learner.simulation.scenarios`, which the help names without loading them; the first is the default."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright sim`."""
    parser.add_argument("--cell", required=True, metavar="C", help="name of the cell")
    names = f"{SCENARIOS[0]} (default), {', '.join(SCENARIOS[1:])}"
    parser.add_argument("--scenario", default=SCENARIOS[0], metavar="NAME", help=f"what stands on its table: {names}")
    parser.add_argument("--speed", type=SPEED, default=1.0, metavar="X", help="its time in units of the wall's (1)")
    parser.add_argument("--seed", type=SEED, metavar="N", help="seed of the start and of the camera's noise")
    parser.add_argument(
        "--noise-mm", type=real(least=0, most=1000), default=1.5, metavar="MM", help="camera noise of positions"
    )
    parser.add_argument(
        "--noise-deg", type=real(least=0, most=180), default=0.3, metavar="DEG", help="camera noise of turns"
    )
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Live until SIGINT or SIGTERM; returns 0."""
    _check(arguments)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with open_session(arguments) as session:
        _live(arguments, console, session, stop)
    return 0


def _live(arguments: argparse.Namespace, console: Console, session: zenoh.Session, stop: threading.Event) -> None:
    import math

    import numpy as np

    from learner.simulation.cell.camera import Noise

    with silent_standard_error():
        from learner.simulation.cell.physics import World
    from pipelines.simulated_cell.cell import Cell

    rng = np.random.default_rng(arguments.seed)
    noise = Noise(arguments.noise_mm / 1000, math.radians(arguments.noise_deg))

    def report(event: Mapping[str, Any]) -> None:
        console.emit(event)
        reason = f": {event['reason']}" if event.get("reason") else ""
        console.say(f"{event['event']}: {event['skill']} {event['execution_id']}{reason}")

    with (
        World(arguments.scenario, rng, noise) as world,
        Cell(session, arguments.cell, world, rng, arguments.speed, report) as cell,
    ):
        console.emit({"ready": True})
        console.emit({"event": "shown", "cell": cell.name, "scenario": arguments.scenario, "objects": world.objects})
        console.say(
            f"the cell {cell.name} shows {arguments.scenario} with {', '.join(world.objects)}; stop with Ctrl-C"
        )
        cell.run(stop)


def _check(arguments: argparse.Namespace) -> None:
    from learner.model import check_name
    from learner.simulation.scenarios import scenario_named

    check_name("cell", arguments.cell)
    scenario_named(arguments.scenario)
