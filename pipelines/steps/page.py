"""A version of a tree as a page for a person: what it does, how sure that is, and what to show next."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from storage.artifacts import Artifact

TITLES: Final[Mapping[str, str]] = {
    "goals": "It brings about",
    "doubtful": "Doubtful, because",
    "approved": "Approved",
    "trials": "How it was tried",
    "users": "Users",
    "questions": "To show next",
    "notes": "Notes",
}


def page_of(artifact: Artifact) -> str:
    """The page, in plain text."""
    parts = [_head(artifact), *(_listed(TITLES[name], said) for name, said in sections_of(artifact).items())]
    return "\n\n".join(part for part in parts if part)


def sections_of(artifact: Artifact) -> dict[str, list[str]]:
    """What there is to say of a version, sentences by the names of TITLES."""
    manifest = artifact.manifest
    return {
        "goals": list(_goals(manifest)),
        "doubtful": list(artifact.standing.doubtful),
        "approved": [f"by {each['by']}" for each in artifact.standing.approved],
        "trials": list(_trials(manifest)),
        "users": [user["sentence"] for user in _report(manifest, "users") if user.get("sentence")],
        "questions": [question["sentence"] for question in _report(manifest, "questions")],
        "notes": list(manifest.get("notes") or ()),
    }


def _head(artifact: Artifact) -> str:
    manifest = artifact.manifest
    metrics = manifest.get("metrics") or {}
    aliases = ", ".join(artifact.aliases) or "no alias"
    learned = f", from {_many(metrics, 'demonstrations')} of {_many(metrics, 'users')}" if metrics.get("users") else ""
    size = f"{manifest['nodes']} nodes, and {manifest['nodes_recovery']} that only recover"
    return (
        f"{artifact.task}@{artifact.version} ({aliases}), {manifest['created']}{learned}\n"
        f"{size}; vocabulary {artifact.tree.vocabulary}; digest {artifact.digest}"
    )


def _many(metrics: Mapping[str, Any], what: str) -> str:
    return f"{metrics[what]} {what if metrics[what] != 1 else what[:-1]}"


def _goals(manifest: Mapping[str, Any]) -> Iterator[str]:
    groups = _report(manifest, "groups")
    for group in groups:
        goal = ", then ".join(group["goal"]) or "nothing"
        yield goal if len(groups) == 1 else f"{goal} (as in {len(group['demonstrations'])} demonstrations)"


def _trials(manifest: Mapping[str, Any]) -> Iterator[str]:
    certificate, report = manifest.get("certificate"), manifest.get("report") or {}
    if certificate:
        yield _proof(certificate)
    rehearsal, replay = report.get("rehearsal") or {}, report.get("replay") or {}
    if rehearsal.get("rollouts"):
        yield f"rehearsed: done in {rehearsal['done']} of {rehearsal['rollouts']} rollouts"
    elif rehearsal:
        yield f"not rehearsed: {rehearsal.get('reason') or 'no start is known'}"
    if runs := replay.get("runs"):
        done = sum(run["verdict"] == "done" for run in runs)
        yield f"replayed with a simulated arm: done in {done} of {len(runs)} runs"
    elif replay:
        yield f"not replayed: {replay.get('reason')}"


def _proof(certificate: Mapping[str, Any]) -> str:
    if certificate.get("counterexample"):
        return f"not proven: from a state with {certificate['counterexample']}"
    begun = "all" if certificate.get("exhaustive") else "a sample of the"
    but = f"; the proof does not see {certificate['left_out']}" if certificate.get("left_out") else ""
    return f"proven from {begun} states of its own conditions ({certificate.get('states')} begun from){but}"


def _report(manifest: Mapping[str, Any], part: str) -> list[Any]:
    return list((manifest.get("report") or {}).get(part) or ())


def _listed(title: str, sentences: Sequence[str]) -> str:
    lines = [f"  - {sentence}" for sentence in sentences]
    return "\n".join([f"{title}:", *lines]) if lines else ""
