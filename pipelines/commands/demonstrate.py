"""`treewright demonstrate`: the operator's buttons (CONTRACT, section 1)."""

from __future__ import annotations

import argparse
import json
import time
from typing import TYPE_CHECKING, Any

from pipelines.commands.options import PATIENCE, STAMP_NS
from pipelines.console import Console
from pipelines.errors import CommandError, UnreachableError
from pipelines.network.session import add_zenoh_arguments, open_session

if TYPE_CHECKING:
    import zenoh

ACTIONS = ("pick", "place", "drop")
REQUESTS = ("pause", "resume", "split", "discard", "status")
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
    start.add_argument("--objects", required=True, nargs="+", metavar="OBJECT", help="names, apart or with commas")
    start.add_argument("--base-frame", default="base", help="default: base")
    start.add_argument("--end-effector-frame", default="tool0", help="default: tool0")
    start.add_argument("--scene", metavar="JSON", help="sizes and symmetries (CONTRACT, section 2), or @FILE")
    for name in ACTIONS:
        action = buttons.add_parser(name, help=f"the end-effector stands where it will {name}", parents=[common])
        action.add_argument("object", nargs="?", help="by default the nearest object, or the one held")
        action.add_argument("--stamp-ns", type=STAMP_NS, help="the moment it was chosen (default: now)")
    stop = buttons.add_parser("stop", help="end the demonstration; answers when it is durable", parents=[common])
    stop.add_argument("--outcome", choices=("success", "failure", "unknown"), default="success")
    for name in REQUESTS:
        buttons.add_parser(name, parents=[common])


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Press one button; what the recorder answers is printed."""
    from learner.model import check_name

    prefix = f"treewright/{check_name('cell', arguments.cell)}"
    with open_session(arguments) as session:
        button = _act if arguments.button in ACTIONS else _ask
        reply = button(session, prefix, arguments)
    console.emit(reply)
    console.say("\n".join(f"{name}: {_shown(value)}" for name, value in reply.items()))
    return 0


def _ask(session: zenoh.Session, prefix: str, arguments: argparse.Namespace) -> dict[str, Any]:
    return ask_recorder(session, prefix, arguments.button, _request(arguments), arguments.timeout)


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


def _request(arguments: argparse.Namespace) -> dict[str, Any]:
    if arguments.button == "stop":
        return {"outcome": arguments.outcome}
    if arguments.button != "start":
        return {}
    return {
        "task": arguments.task,
        "user": arguments.user,
        "objects": [name for word in arguments.objects for name in word.split(",") if name],
        "base_frame": arguments.base_frame,
        "end_effector_frame": arguments.end_effector_frame,
        **({"scene": _scene(arguments.scene)} if arguments.scene else {}),
    }


def _scene(text: str) -> Any:
    from pathlib import Path

    source = Path(text[1:]).read_text() if text.startswith("@") else text
    try:
        return json.loads(source)
    except ValueError as error:
        raise CommandError(f"the scene is not JSON: {error}") from error


def _act(session: zenoh.Session, prefix: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Publish an action, and answer when it is durable."""
    # Asking first brings the route up, so that the one message that follows is not published into the void.
    before = ask_recorder(session, prefix, "status", {}, arguments.timeout)
    stamp_ns = time.time_ns() if arguments.stamp_ns is None else arguments.stamp_ns
    action = {"stamp_ns": stamp_ns, "type": arguments.button}
    if arguments.object is not None:
        action["object"] = arguments.object
    _publish(session, f"{prefix}/action", json.dumps(action))
    if before["state"] != "recording":
        raise CommandError(f"the action {arguments.button} was pressed, but nothing is being recorded; start first")
    return {"action": action, **_when_durable(session, prefix, before, arguments.timeout)}


def _publish(session: zenoh.Session, key: str, payload: str) -> None:
    import zenoh

    from pipelines.network.question import await_somebody
    from recorder.wire import ACTION_ENCODING

    with session.declare_publisher(
        key,
        encoding=ACTION_ENCODING,
        congestion_control=zenoh.CongestionControl.BLOCK,
    ) as publisher:
        await_somebody(publisher, time.monotonic() + APPEARS_S)
        publisher.put(payload)


def _when_durable(session: zenoh.Session, prefix: str, before: dict[str, Any], timeout_s: float) -> dict[str, Any]:
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        status = ask_recorder(session, prefix, "status", {}, timeout_s)
        if status["demonstration_id"] != before["demonstration_id"]:
            raise CommandError("the recording ended before the action was durable; look at `demonstrate status`")
        if status["actions_durable"] > before["actions_durable"]:
            return status
        time.sleep(0.02)
    raise CommandError(f"the action was sent, but is not durable after {timeout_s:g} s; look at `demonstrate status`")


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
