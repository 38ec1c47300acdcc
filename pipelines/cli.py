"""The command line of CONTRACT.md, section 4. Imports only the command that was asked for."""

from __future__ import annotations

import argparse
import importlib
import re
import sys
from collections.abc import Sequence
from typing import Any, Final, NoReturn

from pipelines.console import Console
from pipelines.errors import CommandError

COMMANDS: Final = {
    "demo": "the whole line on a simulated cell: demonstrate, learn, run, report",
    "record": "the recorder daemon of a cell",
    "demonstrate": "the operator's buttons: start, pick, place, drop, stop, ...",
    "panel": "the page for the person at the robot: teach, understand, run",
    "token": "who may use the panel from other machines: add, list, remove",
    "sim": "a simulated cell: poses, gripper, skills",
    "import": "YAML demonstrations of matiov/learn-BTs-from-demo, and rosbag2, become recordings",
    "ingest": "recordings to the lake",
    "demos": "what was demonstrated, and leaving one out",
    "learn": "cluster, infer, plan, verify and publish the tree of a task",
    "approve": "a person takes on what is doubted of a tree",
    "store": "the artifact store: list, show, diff, export, alias, verify",
    "run": "a cell controller: fetch a tree, check it, execute it",
    "world": "the conditions of a cell, answered for other engines",
    "recover": "complete a torn recording from its whole chunks",
    "replay": "publish a recording with its timing",
    "relabel": "correct the type of a demonstrated action",
    "serve": "the scheduled flows and the artifact store on Zenoh and HTTP",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command. Returns 0 on success, 1 on failure after one line on standard error; wrong usage exits 2."""
    words = list(sys.argv[1:] if argv is None else argv)
    name = next((word for word in words if not word.startswith("-")), None)
    parser = _parser(name)
    arguments = parser.parse_args(words)
    console = Console(arguments.json)
    module = importlib.import_module(f"pipelines.commands.{arguments.command.replace('import', 'import_')}")
    try:
        code: int = module.run(arguments, console)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        return console.abandon()
    except Exception as error:  # noqa: BLE001  # the contract: one line and exit 1, whatever went wrong
        if CommandError.covers(error):
            console.fail(error)
        else:
            console.fail_unexpectedly(error)
        return 1
    return code


class Parser(argparse.ArgumentParser):
    """Wrong usage is told with what was probably meant."""

    def error(self, message: str) -> NoReturn:
        """Exit with 2 after one line, as argparse does."""
        super().error(message + _meant(message))


class _Version(argparse.Action):
    """Says which version this is; found only when it is asked for, since looking takes as long as all other help."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(f"treewright {version('treewright')}")
        parser.exit()


def _meant(message: str) -> str:
    """The choice that is nearest to a wrong one."""
    found = re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message)
    if not found:
        return ""
    from difflib import get_close_matches

    near = get_close_matches(found[1], re.findall(r"'([^']*)'", found[2]), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _parser(chosen: str | None) -> argparse.ArgumentParser:
    parser = Parser(
        prog="treewright", description="From shop-floor demonstrations to behavior trees that a robot cell runs."
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="which version this is")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, summary in COMMANDS.items():
        command = commands.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        command.add_argument("--json", action="store_true", help="one JSON document on standard output, nothing else")
        if name == chosen:
            module = importlib.import_module(f"pipelines.commands.{name.replace('import', 'import_')}")
            module.add_arguments(command)
    return parser


if __name__ == "__main__":
    sys.exit(main())
