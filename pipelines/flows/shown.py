"""What a person sees in Prefect's pages: the quarantine, the clusters, the groups, and the tree itself."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from prefect.artifacts import create_image_artifact, create_markdown_artifact, create_table_artifact

from learner.learned import Learned
from pipelines.steps.ingest import IngestResult
from pipelines.steps.learn import Publication
from storage.picture import to_svg


def show_ingested(result: IngestResult) -> None:
    """What was ingested, and the quarantine with its reasons."""
    rows = [
        {"demonstration": d.demonstration_id, "task": d.task, "user": d.user, "outcome": d.outcome}
        for d in result.ingested
    ]
    if rows:
        create_table_artifact(rows, key="ingested", description="demonstrations that are new in the lake")
    if result.quarantined:
        refused = [{"file": each.file, "reason": each.reason} for each in result.quarantined]
        create_table_artifact(refused, key="quarantine", description="recordings that break the contract, and why")


def show_learned(task: str, learned: Learned) -> None:
    """The clusters with their frames, and the groups of demonstrations with their goals."""
    for name, what in (("actions", "clusters"), ("groups", "groups")):
        if rows := learned.report.get(name):
            create_table_artifact(_cells(rows), key=artifact_key(what, task), description=f"{what} of {task}")


def show_publication(publication: Publication, learned: Learned) -> None:
    """The picture of the tree, and a page with its size and the notes."""
    picture = base64.b64encode(to_svg(learned.tree).encode()).decode()
    name = f"{publication.task}@{publication.version}"
    create_image_artifact(
        f"data:image/svg+xml;base64,{picture}", artifact_key("tree", publication.task), f"tree of {name}"
    )
    page = _page(publication, learned.certificate)
    create_markdown_artifact(page, artifact_key("publication", publication.task), f"what was learned as {name}")


def artifact_key(what: str, task: str) -> str:
    """A key as Prefect wants it: lower case letters, digits and dashes."""
    return re.sub(r"[^a-z0-9]+", "-", f"{what}-{task}".lower()).strip("-")


def _cells(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows whose cells are plain: what is nested becomes its JSON."""
    return [
        {key: value if isinstance(value, str | int | float) else json.dumps(value) for key, value in row.items()}
        for row in rows
    ]


def _page(publication: Publication, certificate: Mapping[str, Any] | None) -> str:
    notes = "".join(f"- {note}\n" for note in publication.notes) or "Nothing is in doubt.\n"
    proof = "".join(f"- {name}: {value}\n" for name, value in (certificate or {}).items()) or "None was made.\n"
    size = f"{publication.nodes} nodes and {publication.nodes_recovery} that only recover"
    novelty = "new" if publication.new else "as it was"
    aliases = ", ".join(publication.aliases)
    return (
        f"# {publication.task}@{publication.version}\n\n{size}; {novelty}; aliases {aliases}.\n\n"
        f"Digest `{publication.digest}`\n\n## Notes\n\n{notes}\n## Proof\n\n{proof}"
    )
