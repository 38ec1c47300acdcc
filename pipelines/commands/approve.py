"""`treewright approve T@V --by NAME`: a person takes on what is doubted of a tree (CONTRACT, section 3).

It is `latest` then, unless a newer one is. With --json: {"task", "version", "by", "approved": [sentence], "aliases"}.
"""

from __future__ import annotations

import argparse

from pipelines.console import Console
from pipelines.errors import CommandError
from pipelines.home import Home


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright approve`."""
    parser.add_argument("tree", metavar="T@V", help="task, with the version or alias of its tree")
    parser.add_argument("--by", required=True, metavar="NAME", help="who approves; the store keeps it")


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0; what fails raises."""
    from pipelines.reference import Reference
    from pipelines.steps.stores import open_store

    reference = Reference.parse(arguments.tree)
    chosen = reference.alias if reference.version is None else reference.version
    if chosen is None:
        raise CommandError(f"name the version that you looked at, such as {reference.task}@doubtful")
    with open_store(Home.current()) as store:
        version, before = store.approve(reference.task, chosen, arguments.by)
        aliases = [name for name, number in store.aliases(reference.task).items() if number == version]
    console.emit(
        {"task": reference.task, "version": version, "by": arguments.by, "approved": list(before.doubtful),
         "aliases": aliases}
    )  # fmt: skip
    console.say(
        f"{arguments.by} approves {reference.task}@{version} ({', '.join(aliases) or 'no alias'}), in spite of:"
    )
    for sentence in before.doubtful:
        console.say(f"  {sentence}")
    return 0
