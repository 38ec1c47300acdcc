"""`treewright demonstrate`: the operator's buttons (CONTRACT, section 1).

    start, pause, resume, split, stop, discard, status   as the recorder's requests
    pick [OBJECT], place [OBJECT], drop [OBJECT]         an action; the end-effector stands where it will do it
    signal NAME VALUE                                    a machine's signal that is set; VALUE is JSON, else text
    undo                                                 takes back the newest action that is not taken back yet

An action answers when it is durable, with the recorder's verdict: accepted, doubtful or contradicts, the reason of the
latter two on standard error. It is recorded in each case, so the exit code is 0. With --json: the recorder's reply.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import TYPE_CHECKING, Any

from pipelines.console import Console
from pipelines.errors import CommandError, UnreachableError
from pipelines.network.session import add_zenoh_arguments, open_session
from pipelines.options import PATIENCE, STAMP_NS, add_profile_argument

if TYPE_CHECKING:
    import zenoh

MOVES = ("pick", "place", "drop")
ACTIONS = (*MOVES, "signal", "undo")
REQUESTS = {
    "pause": "what comes is not recorded until resume",
    "resume": "what comes is recorded again",
    "split": "go on in another file of the same demonstration",
    "discard": "end the demonstration and throw it away",
    "status": "what the recorder does, has counted, and is alarmed about",
}
APPEARS_S = 3.0
"""What a session has not heard of for this long [s] after it was opened is not on the network."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The buttons, each with its own options; the common ones may stand before or behind the button."""
    parser.add_argument("--cell", required=True, help="the cell")
    parser.add_argument("--timeout", type=PATIENCE, default=60.0, metavar="S", help="patience with the recorder [s]")
    add_zenoh_arguments(parser)
    common = argparse.ArgumentParser(add_help=False, argument_default=argparse.SUPPRESS)
    common.add_argument("--json", action="store_true", help=argparse.SUPPRESS)
    common.add_argument("--timeout", type=PATIENCE, help=argparse.SUPPRESS)
    add_zenoh_arguments(common)
    buttons = parser.add_subparsers(dest="button", metavar="BUTTON", required=True)
    start = buttons.add_parser("start", help="begin a demonstration", parents=[common])
    start.add_argument("--task", required=True)
    start.add_argument("--user", required=True)
    start.add_argument("--objects", nargs="+", metavar="OBJECT", help="names, apart or with commas (the profile's)")
    start.add_argument("--base-frame", metavar="F", help="default: that of the profile, else base")
    start.add_argument("--end-effector-frame", metavar="F", help="default: that of the profile, else tool0")
    start.add_argument("--scene", metavar="JSON", help="sizes and symmetries (CONTRACT, section 2), or @FILE")
    add_profile_argument(start)
    start.add_argument("--unseen-ok", action="store_true", help="also with names of which the cell's poses do not tell")
    for name in MOVES:
        action = buttons.add_parser(name, help=f"the end-effector stands where it will {name}", parents=[common])
        action.add_argument("object", nargs="?", help="by default the nearest object, or the one held")
        action.add_argument("--stamp-ns", type=STAMP_NS, help="the moment it was chosen (default: now)")
    signal = buttons.add_parser("signal", help="a machine's signal is set", parents=[common])
    signal.add_argument("signal", metavar="NAME")
    signal.add_argument("value", type=_value, metavar="VALUE", help="true, false, a number, or a text")
    signal.add_argument("--stamp-ns", type=STAMP_NS, help="the moment it was chosen (default: now)")
    buttons.add_parser("undo", help="take back the newest action that is not taken back yet", parents=[common])
    stop = buttons.add_parser("stop", help="end the demonstration; answers when it is durable", parents=[common])
    stop.add_argument("--outcome", choices=("success", "failure", "unknown"), default="success")
    for name, does in REQUESTS.items():
        buttons.add_parser(name, help=does, parents=[common])


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Press one button; what the recorder answers is printed."""
    from learner.model import check_name

    prefix = f"treewright/{check_name('cell', arguments.cell)}"
    with open_session(arguments) as session:
        button, tell = (_act, _tell_verdict) if arguments.button in ACTIONS else (_ask, _tell_reply)
        reply = button(session, prefix, arguments)
    console.emit(reply)
    tell(reply, console)
    return 0


def _tell_reply(reply: dict[str, Any], console: Console) -> None:
    console.say("\n".join(f"{name}: {_shown(value)}" for name, value in reply.items()))


def _tell_verdict(reply: dict[str, Any], console: Console) -> None:
    name = f" {reply['object']}" if reply["object"] else ""
    console.say(f"action {reply['step']}: {reply['type']}{name}: {reply['verdict']}")
    if reply["reason"]:
        console.warn(reply["reason"])


def _ask(session: zenoh.Session, prefix: str, arguments: argparse.Namespace) -> dict[str, Any]:
    return ask_recorder(session, prefix, arguments.button, request_of(arguments), arguments.timeout)


def ask_recorder(
    session: zenoh.Session, prefix: str, verb: str, request: dict[str, Any], timeout_s: float
) -> dict[str, Any]:
    """The recorder's reply to a request.

    Raises CommandError with the recorder's own sentence if it refuses, UnreachableError if it does not answer.
    """
    from pipelines.network.question import await_somebody

    with session.declare_querier(f"{prefix}/recorder/{verb}", timeout=timeout_s) as querier:
        await_somebody(querier, time.monotonic() + min(timeout_s, APPEARS_S))
        for reply in querier.get(payload=json.dumps(request), encoding="application/json"):
            if reply.ok is not None:
                answer: dict[str, Any] = json.loads(reply.ok.payload.to_bytes())
                return answer
            raise _refusal(prefix, reply.err.payload.to_string() if reply.err else "no reason was given")
    raise UnreachableError(f"no recorder answers for {prefix}; start `treewright record` or check --connect")


def _refusal(prefix: str, text: str) -> CommandError:
    try:
        sentence = json.loads(text)["error"]
    except (ValueError, TypeError, KeyError):
        # Zenoh itself answers an unanswered query with a bare word.
        return UnreachableError(f"the recorder of {prefix} did not answer in time ({text or 'no reason'})")
    return CommandError(f"{sentence}")


def request_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """What a button asks of the recorder (CONTRACT, section 1)."""
    if arguments.button == "stop":
        return {"outcome": arguments.outcome}
    if arguments.button != "start":
        return {}
    return {"task": arguments.task, "user": arguments.user, **_known(arguments), **_given(arguments)}


def _known(arguments: argparse.Namespace) -> dict[str, Any]:
    """What the cell's profile says here. Where there is none and no object is named, the recorder may have one."""
    from pipelines.home import Home
    from pipelines.profile import FRAMES, profile_of

    profile = profile_of(arguments.cell, Home.current(), arguments.profile)
    if profile is not None:
        return profile.start()
    return dict(FRAMES) if arguments.objects else {}


def _given(arguments: argparse.Namespace) -> dict[str, Any]:
    """What the command line says."""
    from pipelines.profile import scene_told

    objects = [name for word in arguments.objects or () for name in word.split(",") if name]
    said = {
        "objects": objects if arguments.objects else None,
        "base_frame": arguments.base_frame,
        "end_effector_frame": arguments.end_effector_frame,
        "scene": scene_told(arguments.scene) if arguments.scene else None,
        "unseen_ok": arguments.unseen_ok or None,
    }
    return {name: value for name, value in said.items() if value is not None}


def _value(text: str) -> bool | float | str:
    """The value of a signal: what is JSON and neither null, a list nor an object is that, anything else a text."""
    try:
        value = json.loads(text)
    except ValueError:
        return text
    return value if isinstance(value, bool | int | float | str) else text


def _act(session: zenoh.Session, prefix: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Press an action, and answer when it is durable."""
    before = ask_recorder(session, prefix, "status", {}, arguments.timeout)
    given = {name: getattr(arguments, name, None) for name in ("object", "signal", "value", "stamp_ns")}
    request = {"type": arguments.button, **{name: value for name, value in given.items() if value is not None}}
    reply = ask_recorder(session, prefix, "press", request, arguments.timeout)
    _await_durable(session, prefix, before, arguments.timeout)
    return reply


def _await_durable(session: zenoh.Session, prefix: str, before: dict[str, Any], timeout_s: float) -> None:
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        status = ask_recorder(session, prefix, "status", {}, timeout_s)
        if status["demonstration_id"] != before["demonstration_id"]:
            raise CommandError("the recording ended before the action was durable; look at `demonstrate status`")
        if status["actions_durable"] > before["actions_durable"]:
            return
        time.sleep(0.02)
    raise CommandError(f"the action was sent, but is not durable after {timeout_s:g} s; look at `demonstrate status`")


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
