"""`treewright sim`: a simulated cell lives on Zenoh until it is told to stop, or one that lives is played with.

    sim --cell C                            it lives: what stands on its table is the cell's profile, else a scenario
    sim --cell C reset                      everything stands at another random start
    sim --cell C move OBJECT [X Y [Z]]      somebody pulls an object about: to a place in the base [m], else anywhere
    sim --cell C take OBJECT                somebody takes an object away, until it is moved somewhere
    sim --cell C hand TARGET [DX DY DZ]     the operator leads the hand to an object, or to a place beside or over it
    sim --cell C grip open|closed           the operator moves the fingers
    sim --cell C truth                      where everything truly is

With --json events, or of what is played with the truth: {"poses", "held", "gripper", "goal", ...}.
"""

from __future__ import annotations

import argparse
import signal
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from pipelines.console import Console, silent_standard_error
from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.network.session import add_zenoh_arguments, open_session
from pipelines.options import SEED, SPEED, add_profile_argument, real

if TYPE_CHECKING:
    import zenoh

    from learner.simulation.scenarios import Scenario
    from pipelines.profile import Profile

SCENARIOS: Final = ("object_in_box", "towers", "tower_and_box", "kitting", "hanoi")
"""Those of `learner.simulation.scenarios`, which the help names without loading them; the first is the default."""
METRES: Final = real(least=-10, most=10)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright sim`; the common ones may stand before or behind what is done."""
    parser.add_argument("--cell", metavar="C", help="name of the cell")
    add_profile_argument(parser)
    names = f"{SCENARIOS[0]} (default), {', '.join(SCENARIOS[1:])}"
    parser.add_argument("--scenario", metavar="NAME", help=f"what stands on the table instead of the profile: {names}")
    parser.add_argument(
        "--save-profile",
        action="store_true",
        help="write what the scenario shows as the cell's profile",
    )
    parser.add_argument("--speed", type=SPEED, default=1.0, metavar="X", help="its time in units of the wall's (1)")
    parser.add_argument("--seed", type=SEED, metavar="N", help="seed of the start and of the camera's noise")
    parser.add_argument(
        "--noise-mm", type=real(least=0, most=1000), default=1.5, metavar="MM", help="camera noise of positions"
    )
    parser.add_argument(
        "--noise-deg", type=real(least=0, most=180), default=0.3, metavar="DEG", help="camera noise of turns"
    )
    add_zenoh_arguments(parser)
    parser.set_defaults(refuse=parser.error)
    _add_plays(parser)


def _add_plays(parser: argparse.ArgumentParser) -> None:
    common = argparse.ArgumentParser(add_help=False, argument_default=argparse.SUPPRESS)
    common.add_argument("--json", action="store_true", help=argparse.SUPPRESS)
    common.add_argument("--cell", metavar="C", help="name of the cell")
    add_zenoh_arguments(common)
    plays = parser.add_subparsers(dest="play", metavar="PLAY", title="with a cell that lives")
    reset = plays.add_parser("reset", help="everything stands at another random start", parents=[common])
    reset.add_argument("--seed", type=SEED, metavar="N", help="of the start", default=None)
    move = plays.add_parser("move", help="somebody pulls an object about", parents=[common])
    move.add_argument("object", metavar="OBJECT")
    move.add_argument("place", nargs="*", type=METRES, metavar="X Y [Z]", help="in the base [m]; else anywhere free")
    take = plays.add_parser("take", help="somebody takes an object away, until it is moved somewhere", parents=[common])
    take.add_argument("object", metavar="OBJECT")
    hand = plays.add_parser("hand", help="the operator leads the hand to an object, or to beside it", parents=[common])
    hand.add_argument("target", metavar="TARGET", help="an object, or the base frame")
    hand.add_argument("offset", nargs="*", type=METRES, metavar="DX DY DZ", help="along the target's axes [m] (0 0 0)")
    hand.add_argument("--turn", type=real(least=0, most=360), metavar="DEG", help="from the target's x axis")
    grip = plays.add_parser("grip", help="the operator moves the fingers", parents=[common])
    grip.add_argument("state", choices=("open", "closed"))
    plays.add_parser("truth", help="where everything truly is", parents=[common])


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Live until SIGINT or SIGTERM, or play once; returns 0."""
    if arguments.cell is None:
        arguments.refuse("the following arguments are required: --cell")
    if arguments.play is not None:
        return _play(arguments, console)
    profile, table = _table(arguments, console)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with open_session(arguments) as session:
        _live(arguments, console, session, stop, profile, table)
    return 0


def _table(arguments: argparse.Namespace, console: Console) -> tuple[Profile | None, Scenario | str]:
    """The cell's profile and what stands on the table by it; a scenario that is named wins."""
    from learner.model import check_name
    from learner.simulation.scenarios import scenario_named
    from pipelines.profile import profile_of
    from pipelines.simulated_cell.table import scenario_of

    cell, home = check_name("cell", arguments.cell), Home.current()
    profile = None if arguments.scenario else profile_of(cell, home, arguments.profile)
    if profile is not None:
        return profile, scenario_of(profile)
    name = arguments.scenario or SCENARIOS[0]
    scenario = scenario_named(name)
    if arguments.save_profile:
        _save(scenario, cell, home, console)
    return None, name


def _save(scenario: Scenario, cell: str, home: Home, console: Console) -> None:
    from pipelines.profile import written
    from pipelines.simulated_cell.table import profile_of_scenario

    file = home.cells / f"{cell}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(written(profile_of_scenario(scenario)))
    except FileExistsError:
        raise CommandError(f"{file} is there already; leave out --scenario and --save-profile to use it") from None
    console.say(f"the profile of {cell} is {file}")


def _live(
    arguments: argparse.Namespace,
    console: Console,
    session: zenoh.Session,
    stop: threading.Event,
    profile: Profile | None,
    table: Scenario | str,
) -> None:
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
        World(table, rng, noise) as world,
        Cell(session, arguments.cell, world, rng, arguments.speed, report, profile) as cell,
    ):
        shown = world.scenario_name or None
        console.emit({"ready": True})
        console.emit({"event": "shown", "cell": cell.name, "scenario": shown, "objects": world.objects})
        objects = ", ".join(world.objects)
        console.say(f"the cell {cell.name} shows {shown or 'its profile'}: {objects}; stop with Ctrl-C")
        cell.run(stop)


def _play(arguments: argparse.Namespace, console: Console) -> int:
    from learner.model import check_name

    check_name("cell", arguments.cell)
    with open_session(arguments) as session:
        truth = PLAYS[arguments.play](session, arguments)
    console.emit(truth)
    for name, pose in sorted(truth["poses"].items()):
        x, y, z = pose["position"]
        console.say(f"{name:<16} ({x:.3f}, {y:.3f}, {z:.3f})")
    if truth["away"]:
        console.say(f"taken away: {', '.join(truth['away'])}")
    console.say(f"the gripper is {truth['gripper']} and holds {truth['held'] or 'nothing'}")
    return 0


def _reset(session: zenoh.Session, arguments: argparse.Namespace) -> dict[str, Any]:
    return _ask(session, arguments, "reset", {} if arguments.seed is None else {"seed": arguments.seed})


def _move(session: zenoh.Session, arguments: argparse.Namespace) -> dict[str, Any]:
    if len(arguments.place) not in (0, 2, 3):
        arguments.refuse(f"a place is X Y or X Y Z, not {len(arguments.place)} numbers")
    fields: dict[str, Any] = {"object": arguments.object}
    if arguments.place:
        fields["position"] = [*arguments.place, *([_height_m(session, arguments)] if len(arguments.place) == 2 else [])]
    return _ask(session, arguments, "disturb", fields)


def _height_m(session: zenoh.Session, arguments: argparse.Namespace) -> float:
    """Of the origin of an object that stands on the table."""
    shapes = _ask(session, arguments, "scene", {})["scene"]["objects"]
    return float(shapes[arguments.object]["size_m"][2]) / 2 if arguments.object in shapes else 0.0


def _take(session: zenoh.Session, arguments: argparse.Namespace) -> dict[str, Any]:
    return _ask(session, arguments, "disturb", {"object": arguments.object, "away": True})


def _hand(session: zenoh.Session, arguments: argparse.Namespace) -> dict[str, Any]:
    from pipelines.simulated_cell.hand import Hand

    if len(arguments.offset) not in (0, 3):
        arguments.refuse(f"beside a target is DX DY DZ, not {len(arguments.offset)} numbers")
    return Hand(session, arguments.cell).lead(arguments.target, arguments.offset or (0.0, 0.0, 0.0), arguments.turn)


def _grip(session: zenoh.Session, arguments: argparse.Namespace) -> dict[str, Any]:
    from pipelines.simulated_cell.hand import Hand

    return Hand(session, arguments.cell).grip(arguments.state)


def _truth(session: zenoh.Session, arguments: argparse.Namespace) -> dict[str, Any]:
    return _ask(session, arguments, "truth", {})


def _ask(session: zenoh.Session, arguments: argparse.Namespace, what: str, fields: dict[str, Any]) -> dict[str, Any]:
    from pipelines.network.question import ask

    return ask(session, f"treewright/{arguments.cell}/sim/{what}", fields)


PLAYS: Final[Mapping[str, Callable[[zenoh.Session, argparse.Namespace], dict[str, Any]]]] = {
    "reset": _reset,
    "move": _move,
    "take": _take,
    "hand": _hand,
    "grip": _grip,
    "truth": _truth,
}
