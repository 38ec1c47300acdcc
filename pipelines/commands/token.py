"""`treewright token`: who may use the panel from other machines.

    add NAME --role operator|engineer   a token, shown this once; one that the name had counts no more
    list                                the names, their roles, and since when
    remove NAME                         take it away

With --json: {"name", "role", "token"}; [{"name", "role", "since_ns"}]; {"name", "removed": true}.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from pipelines.console import Console
from pipelines.home import Home

if TYPE_CHECKING:
    from pipelines.panel.access.tokens import Tokens

ROLES: Final = ("operator", "engineer")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright token`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for name, summary in (("add", "make a token"), ("list", "who has one"), ("remove", "take a token away")):
        action = actions.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        action.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)
        if name != "list":
            action.add_argument("name", metavar="NAME", help="whose token it is")
        if name == "add":
            action.add_argument(
                "--role", choices=ROLES, required=True, help="operator teaches and runs; engineer also judges"
            )


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0; what fails raises."""
    from pipelines.panel.access.tokens import Tokens

    ACTIONS[arguments.action](Tokens(Home.current().tokens), arguments, console)
    return 0


def _add(tokens: Tokens, arguments: argparse.Namespace, console: Console) -> None:
    secret = tokens.add(arguments.name, arguments.role)
    console.emit({"name": arguments.name, "role": arguments.role, "token": secret})
    console.say(f"the token of {arguments.name}, {arguments.role}; it is shown this once: {secret}")


def _list(tokens: Tokens, _: argparse.Namespace, console: Console) -> None:
    console.emit([{"name": each.name, "role": each.role, "since_ns": each.since_ns} for each in tokens.all()])
    for each in tokens.all():
        since = datetime.fromtimestamp(each.since_ns // 10**9, UTC)
        console.say(f"{each.name}  {each.role}  since {since:%Y-%m-%d %H:%M}")


def _remove(tokens: Tokens, arguments: argparse.Namespace, console: Console) -> None:
    tokens.remove(arguments.name)
    console.emit({"name": arguments.name, "removed": True})
    console.say(f"the token of {arguments.name} counts no more")


ACTIONS: Final[dict[str, Callable[[Tokens, argparse.Namespace, Console], None]]] = {
    "add": _add,
    "list": _list,
    "remove": _remove,
}
