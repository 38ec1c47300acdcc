"""The gate before `latest`: why a tree is doubtful (CONTRACT, section 3, "Explained, or said")."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from learner.learned import Learned
from learner.model.doubt import Doubt

LEAST_REHEARSED: Final = 0.95
"""A tree that is done in a smaller share of its rehearsal's rollouts is doubtful (CONTRACT, section 3)."""


def reasons_against(learned: Learned, doubts: Sequence[Doubt]) -> tuple[str, ...]:
    """Sentences on why a tree is not to be `latest` until a person approves it; none for a good one.

    What was left out for want of shapes, or of reach of the simulated arm, is no reason: the notes tell it.
    """
    counterexample = (learned.certificate or {}).get("counterexample")
    return (
        *(doubt.sentence for doubt in doubts),
        *((f"it is not proven: from a state with {counterexample}",) if counterexample else ()),
        *_rehearsed(learned.report.get("rehearsal", {})),
        *_replayed(learned.report.get("replay", {})),
    )


def untried(learned: Learned) -> tuple[str, ...]:
    """Sentences on what was not tried, so that nobody takes its silence for success."""
    rehearsal, replay = (learned.report.get(name, {}) for name in ("rehearsal", "replay"))
    unrehearsed = rehearsal.get("reason")
    return (
        *((f"it was not rehearsed: {unrehearsed}",) if unrehearsed else ()),
        *((f"it was not replayed with the simulated arm: {replay['reason']}",) if replay.get("reason") else ()),
    )


def _rehearsed(rehearsal: Mapping[str, Any]) -> Iterator[str]:
    done, count = rehearsal.get("done", 0), rehearsal.get("rollouts", 0)
    if count and done < LEAST_REHEARSED * count:
        first = rehearsal["failures"][0] if rehearsal.get("failures") else "no failure was kept"
        yield f"it was done in only {done} of {count} rollouts of its rehearsal: {first}"


def _replayed(replay: Mapping[str, Any]) -> Iterator[str]:
    runs = replay.get("runs", ())
    if runs and not any(run["verdict"] == "done" for run in runs):
        yield f"none of its {len(runs)} replays with the simulated arm was done: {runs[0]['sentence']}"
