"""What a person sees in Prefect's pages: the quarantine, the clusters, the goals in their order, the tree, the time."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final
from urllib.parse import quote

from prefect.artifacts import create_image_artifact, create_markdown_artifact, create_table_artifact

from learner.learned import Learned
from learner.model.tree import Node, Tree, Value, is_recovery
from learner.model.vocabulary import REFERENCE, SUBTREE
from pipelines.service.prefect_server import STORE_HTTP
from pipelines.steps.cluster_picture import clusters_svg
from pipelines.steps.ingest import IngestResult
from pipelines.steps.learn import Publication

MOST_ROWS: Final = 1000
"""A table of more says how many there are."""
MOST_LINES: Final = 120


def show_ingested(result: IngestResult) -> None:
    """What was ingested, and the quarantine with its reasons."""
    rows = [
        {"demonstration": d.demonstration_id, "task": d.task, "user": d.user, "outcome": d.outcome}
        for d in result.ingested
    ]
    if rows:
        _show_table("ingested", rows, "demonstrations that are new in the lake")
    if result.quarantined:
        lines = [f"| {_file_link(each.file)} | {_cell(each.reason)} |" for each in result.quarantined[:MOST_ROWS]]
        page = "\n".join(["# Recordings that break the contract", "", "| file | reason |", "|---|---|", *lines])
        more = len(result.quarantined) - MOST_ROWS
        page += f"\n\n… and {more} more.\n" if more > 0 else "\n"
        create_markdown_artifact(page, "quarantine", f"{len(result.quarantined)} recordings were refused, and why")


def show_learned(publication: Publication, learned: Learned) -> None:
    """The clusters in each candidate frame, the targets that they became, and the goals in their order."""
    task, name = publication.task, _name(publication)
    if learned.draft:
        picture = f"data:image/svg+xml,{quote(clusters_svg(learned.draft.understood))}"
        create_image_artifact(picture, artifact_key("clusters", task), f"where things were put for {name}, by frame")
    for part, key in (("actions", "targets"), ("groups", "goals")):
        if rows := learned.report.get(part):
            _show_table(artifact_key(key, task), _cells(rows), f"{key} of {name}")


def show_publication(publication: Publication, learned: Learned) -> None:
    """A page with the tree, its size, the notes and what was proven."""
    page = _page(publication, learned)
    create_markdown_artifact(page, artifact_key("tree", publication.task), f"what was learned as {_name(publication)}")


def show_timings(publication: Publication, seconds: Mapping[str, float]) -> None:
    """How long each stage took."""
    rows = [{"stage": stage, "seconds": round(spent_s, 3)} for stage, spent_s in seconds.items()]
    _show_table(artifact_key("timings", publication.task), rows, f"how long learning {_name(publication)} took")


def artifact_key(what: str, task: str) -> str:
    """A key as Prefect wants it: lower case letters, digits and dashes."""
    return re.sub(r"[^a-z0-9]+", "-", f"{what}-{task}".lower()).strip("-")


def outline(tree: Tree) -> str:
    """The tree as indented lines; what only recovers is one line, and what is very long is cut."""
    lines = list(_lines(tree.main.root, {}, tree, 0))
    more = [f"… and {len(lines) - MOST_LINES} more lines"] if len(lines) > MOST_LINES else []
    return "\n".join([*lines[:MOST_LINES], *more])


def _lines(node: Node, told: Mapping[str, Value], tree: Tree, depth: int) -> Iterator[str]:
    """`told` are the values of the ports of the SubTree that the node is in."""
    ports = {name: _resolved(value, told) for name, value in sorted(node.ports, key=lambda port: port[0] != "object")}
    words = [str(node.id) if node.kind == SUBTREE else node.kind, *(v for v in ports.values() if isinstance(v, str))]
    yield "  " * depth + " ".join(words)
    used = node.kind == SUBTREE and not is_recovery(node)
    for child in (tree.definitions[str(node.id)].root,) if used else node.children:
        yield from _lines(child, ports if used else told, tree, depth + 1)


def _resolved(value: Value, told: Mapping[str, Value]) -> Value:
    reference = REFERENCE.fullmatch(value) if isinstance(value, str) else None
    return told.get(reference[1], value) if reference else value


def _page(publication: Publication, learned: Learned) -> str:
    notes = "".join(f"- {note}\n" for note in publication.notes) or "Nothing is to be said.\n"
    doubts = "".join(f"- {reason}\n" for reason in publication.doubtful) or "Nothing is in doubt.\n"
    proof = "".join(f"- {name}: {value}\n" for name, value in (learned.certificate or {}).items()) or "None was made.\n"
    size = f"{publication.nodes} nodes and {publication.nodes_recovery} that only recover"
    novelty, aliases = "new" if publication.new else "as it was", ", ".join(publication.aliases)
    return (
        f"# {_name(publication)}\n\n{size}; {novelty}; aliases {aliases}.\n\n{_picture(publication)}"
        f"```\n{outline(learned.tree)}\n```\n\nDigest `{publication.digest}`\n\n"
        f"## Doubts\n\n{doubts}\n## Notes\n\n{notes}\n## Proof\n\n{proof}"
    )


def _picture(publication: Publication) -> str:
    """A link to the picture that the store serves, where it is served."""
    served = os.environ.get(STORE_HTTP)
    return f"[picture]({served}/v1/tasks/{publication.task}/{publication.version}/tree.svg)\n\n" if served else ""


def _show_table(key: str, rows: Sequence[Mapping[str, Any]], description: str) -> None:
    shown = [dict(row) for row in rows[:MOST_ROWS]]
    more = f" ({len(rows)}, of which the first {MOST_ROWS} are shown)" if len(rows) > MOST_ROWS else ""
    create_table_artifact(shown, key=key, description=description + more)


def _cells(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows whose cells are plain: what is nested becomes its JSON."""
    return [
        {key: value if isinstance(value, str | int | float) else json.dumps(value) for key, value in row.items()}
        for row in rows
    ]


def _file_link(file: str) -> str:
    return f"[{_cell(file)}](file://{quote(file)})"


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())


def _name(publication: Publication) -> str:
    return f"{publication.task}@{publication.version}"
