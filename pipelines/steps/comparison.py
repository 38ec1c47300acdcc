"""Two versions beside each other: what changed in words, what they were learned from, and what is doubted of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from storage.artifacts import Artifact
from storage.difference import Change, differences, many

TITLES: Final = {
    "goal": "Goals",
    "order": "Order",
    "label": "Place or drop",
    "frame": "Frames",
    "pose": "Poses",
    "tolerance": "Tolerances",
    "structure": "Structure",
    "recovery": "Recovery",
    "evidence": "Learned from",
    "doubt": "Doubts",
}
"""The kinds of changes in the order in which a person reads them."""


def compared(old: Artifact, new: Artifact) -> tuple[Change, ...]:
    """All that changed from one version to another. Raises DamagedError for bytes that are no tree or manifest."""
    return (*differences(old.tree, new.tree), *_evidence(old.manifest, new.manifest), *_doubts(old, new))


def comparison_of(old: Artifact, new: Artifact, changes: Sequence[Change]) -> str:
    """The changes as a page for a person, in plain text."""
    head = f"{_named(old)} and {_named(new)}"
    if old.digest == new.digest:
        head += "\nThe trees are equal."
    told = {what: [change.sentence for change in changes if change.what == what] for what in TITLES}
    parts = [f"{TITLES[what]}:\n" + "\n".join(f"  - {each}" for each in told[what]) for what in TITLES if told[what]]
    return "\n\n".join([head, *parts])


def comparison_to_data(old: Artifact, new: Artifact, changes: Sequence[Change]) -> dict[str, Any]:
    """The JSON document of the command."""
    return {
        "from": _identity(old),
        "to": _identity(new),
        "equal": old.digest == new.digest,
        "changes": [change.to_data() for change in changes],
    }


def _identity(artifact: Artifact) -> dict[str, Any]:
    return {"task": artifact.task, "version": artifact.version, "digest": artifact.digest}


def _named(artifact: Artifact) -> str:
    size = f"{many(artifact.tree.nodes, 'node')}, and {artifact.tree.nodes_recovery} that only recover"
    return f"{artifact.task}@{artifact.version} ({size})"


def _evidence(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[Change]:
    ours, theirs = _lineage(old), _lineage(new)
    if ours["method"] != theirs["method"]:
        sentence = f"learned by the method {theirs['method']} now; it was {ours['method']}"
        yield Change("evidence", None, sentence, ours["method"], theirs["method"])
    before, after = ours["demonstrations"], theirs["demonstrations"]
    if before != after:
        added, dropped = len(after - before), len(before - after)
        sentence = f"{many(len(after), 'demonstration')} now, {len(before)} before: {added} new, {dropped} left out"
        yield Change("evidence", None, sentence, sorted(before), sorted(after))


def _lineage(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Method and demonstrations; of a tree that was not learned here, none."""
    lineage = manifest.get("lineage") or {}
    ids = {each["demonstration_id"] for each in lineage.get("demonstrations") or ()}
    return {"method": lineage.get("method"), "demonstrations": ids}


def _doubts(old: Artifact, new: Artifact) -> Iterator[Change]:
    before, after = old.standing.doubtful, new.standing.doubtful
    for sentence in after:
        if sentence not in before:
            yield Change("doubt", None, f"doubtful now, because {sentence}", None, sentence)
    for sentence in before:
        if sentence not in after:
            yield Change("doubt", None, f"not doubted any more: {sentence}", sentence, None)
