"""`treewright store`: the artifact store on the command line.

    list                              the tasks with all versions and aliases
    show T[@V]                        a page for people; with --json the manifest
    diff T[@V] T[@V]                  what changed in words: goals, order, frames, poses in millimetres, tolerances
    export T[@V] --format F -o FILE   the tree as btcpp (XML), json or svg; `-` is standard output
    alias T NAME VERSION              let an alias point to a version; `production` moves by this alone
    verify T[@V]                      hash everything again, validate the XML, compare with the manifest

`@V` is a version or an alias; without it `production` if set, else `latest`. With --json:

    list     [{"task", "version", "digest", "aliases": {name: version}, "versions": [{"version", "digest", "created",
             "nodes", "nodes_recovery", "aliases": [name], "doubtful", "approved"}]}], version and digest the newest;
             a version whose manifest is damaged says so in "damaged", and what only that tells is null
    show     the manifest with "aliases": [name], "doubtful": [sentence] and "approved": [{"by", "stamp_ns"}] added
    diff     {"from": {"task", "version", "digest"}, "to": the same, "equal", "changes": [{"what", "object", "sentence",
             "before", "after"}]}, `what` being goal, order, label, frame, pose, tolerance, structure, recovery,
             evidence or doubt
    export   {"task", "version", "digest", "format", "file"}
    alias    {"task", "alias", "version", "changed"}
    verify   {"task", "version", "digest", "verified": true}

The database lies in the data root, or where TREEWRIGHT_STORE_URL says.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pipelines.console import Console
from pipelines.home import Home
from pipelines.options import INDEX

if TYPE_CHECKING:
    from storage.artifacts import Artifact, ArtifactStore

STANDARD_OUTPUT: Final = "-"
FORMATS: Final = ("btcpp", "json", "svg")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `treewright store`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    _add(actions, "list", "the tasks with all versions and aliases")
    _add(actions, "show", "what a version does, and how sure that is").add_argument(
        "tree", metavar="T[@V]", help=_TREE_HELP
    )
    diff = _add(actions, "diff", "what changed between two versions, in words")
    diff.add_argument("tree", metavar="T[@V]", help=_TREE_HELP)
    diff.add_argument("other", metavar="T[@V]", help="the version that it is compared with, likewise")
    export = _add(actions, "export", "write a tree")
    export.add_argument("tree", metavar="T[@V]", help=_TREE_HELP)
    export.add_argument("--format", choices=FORMATS, default="btcpp", help="BehaviorTree.CPP XML, JSON or a picture")
    export.add_argument(
        "-o", "--output", metavar="F", default=STANDARD_OUTPUT, help="file to write; - is standard output (default)"
    )
    export.set_defaults(refuse=export.error)
    alias = _add(actions, "alias", "let an alias point to a version")
    alias.add_argument("tree", metavar="T", help="task")
    alias.add_argument("name", metavar="NAME", help="alias, such as production")
    alias.add_argument("version", metavar="VERSION", type=INDEX, help="number of the version")
    _add(actions, "verify", "check that a version is whole and valid").add_argument(
        "tree", metavar="T[@V]", help=_TREE_HELP
    )


def run(arguments: argparse.Namespace, console: Console) -> int:
    """Returns 0; what fails raises."""
    if arguments.action == "export" and console.as_json and arguments.output == STANDARD_OUTPUT:
        arguments.refuse("--json leaves standard output to the report; name a file with -o")
    from pipelines.steps.stores import open_store

    with open_store(Home.current()) as store:
        ACTIONS[arguments.action](store, arguments, console)
    return 0


_TREE_HELP: Final = "task, with a version or an alias (else production, else latest)"


def _add(
    actions: argparse._SubParsersAction[argparse.ArgumentParser], name: str, help_: str
) -> argparse.ArgumentParser:
    parser = actions.add_parser(name, help=help_, description=f"{help_[0].upper()}{help_[1:]}.")
    # Also after the action, where people write it; not given there, the option before the action stands.
    parser.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)
    return parser


def _list(store: ArtifactStore, _: argparse.Namespace, console: Console) -> None:
    tasks = [row | {"versions": store.versions(row["task"])} for row in store.tasks()]
    console.emit(tasks)
    for row in tasks:
        for each in row["versions"]:
            console.say(_line(f"{row['task']}@{each['version']}", each))
    if not tasks:
        console.say(f"nothing is stored in {store.root}; `treewright learn TASK` publishes a tree")


def _line(name: str, version: Mapping[str, Any]) -> str:
    """A version in the list; of a damaged one what is known, and the damage."""
    size = f"{version['nodes']} nodes, {version['nodes_recovery']} that recover"
    said = version.get("damaged") or f"{version['created']}  {version['digest'][:12]}  {size}"
    return f"{name}  {said}  {', '.join(version['aliases'])}".rstrip()


def _show(store: ArtifactStore, arguments: argparse.Namespace, console: Console) -> None:
    from pipelines.steps.page import page_of

    artifact = _chosen(store, arguments.tree)
    document = {**artifact.manifest, **artifact.standing.to_data(), "aliases": list(artifact.aliases)}
    console.emit(document)
    console.say(page_of(artifact))


def _diff(store: ArtifactStore, arguments: argparse.Namespace, console: Console) -> None:
    from pipelines.steps.comparison import compared, comparison_of, comparison_to_data

    old, new = _chosen(store, arguments.tree), _chosen(store, arguments.other)
    changes = compared(old, new)
    console.emit(comparison_to_data(old, new, changes))
    console.say(comparison_of(old, new, changes))


def _export(store: ArtifactStore, arguments: argparse.Namespace, console: Console) -> None:
    artifact = _chosen(store, arguments.tree)
    text = _rendered(artifact, arguments.format)
    if arguments.output == STANDARD_OUTPUT:
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    file = Path(arguments.output).absolute()
    _write(file, text)
    console.say(f"{artifact.task}@{artifact.version} as {arguments.format}: {file}")
    document = {"task": artifact.task, "version": artifact.version, "digest": artifact.digest}
    console.emit(document | {"format": arguments.format, "file": str(file)})


def _alias(store: ArtifactStore, arguments: argparse.Namespace, console: Console) -> None:
    task, name, version = arguments.tree, arguments.name, arguments.version
    changed = store.alias(task, name, version)
    console.say(f"{name} of {task} {'is now' if changed else 'was already'} version {version}")
    console.emit({"task": task, "alias": name, "version": version, "changed": changed})


def _verify(store: ArtifactStore, arguments: argparse.Namespace, console: Console) -> None:
    chosen = _reference(arguments.tree)
    artifact = store.verify(*chosen)
    console.say(f"{artifact.task}@{artifact.version} is whole and valid: digest {artifact.digest}")
    console.emit({"task": artifact.task, "version": artifact.version, "digest": artifact.digest, "verified": True})


ACTIONS: Final[dict[str, Callable[[ArtifactStore, argparse.Namespace, Console], None]]] = {
    "list": _list,
    "show": _show,
    "diff": _diff,
    "export": _export,
    "alias": _alias,
    "verify": _verify,
}


def _reference(text: str) -> tuple[str, str | int | None]:
    from pipelines.reference import Reference

    reference = Reference.parse(text)
    return reference.task, reference.alias if reference.version is None else reference.version


def _chosen(store: ArtifactStore, text: str) -> Artifact:
    return store.get(*_reference(text))


def _rendered(artifact: Artifact, format_: str) -> str:
    if format_ == "json":
        return artifact.tree_json + "\n"
    if format_ == "svg":
        from storage.picture import to_svg

        return to_svg(artifact.tree)
    return artifact.xml


def _write(file: Path, text: str) -> None:
    from recorder.durable import whole

    with whole(file) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
