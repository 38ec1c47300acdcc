"""The demonstration that is being recorded."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from recorder.daemon.writing import Writing
from recorder.foxglove import SHOWN
from recorder.intake.ledger import Balance
from recorder.recording import Demonstrated, Finished
from recorder.teaching.feedback import gaps_near_actions
from recorder.teaching.presses import Presses

NOTES: Final = "notes"
"""The entry of a recording's metadata that tells, as a JSON array of sentences, what was odd."""


@dataclass
class Take:
    """A demonstration with its present part and the finished ones."""

    demonstrated: Demonstrated
    writing: Writing
    begun_s: float
    """When the present part began, by a monotonic clock [s]."""
    presses: Presses
    parts: list[Finished] = field(default_factory=list)
    durable_before: int = 0
    """Actions in the parts that are finished."""
    unseen: tuple[str, ...] = ()
    """Objects that were not seen at the last action."""
    silence_told: bool = False
    """Whether topics on which nothing comes have been looked for."""
    stamps: list[tuple[int, str]] = field(default_factory=list)
    """Stamp [ns] and type of every action."""

    @property
    def demonstration_id(self) -> str:
        """Its identifier."""
        return self.demonstrated.demonstration_id

    @property
    def actions_durable(self) -> int:
        """How many actions a crash can no longer take away."""
        return self.durable_before + self.writing.actions_durable

    def go_on(self, demonstrated: Demonstrated, writing: Writing, begun_s: float) -> Take:
        """Go on in another part; returns the demonstration as it was in the part that ends, to be finished."""
        before = replace(self, demonstrated=replace(self.demonstrated, part=self.demonstrated.part or 1))
        self.demonstrated, self.writing, self.begun_s = demonstrated, writing, begun_s
        return before

    def add_part(self, before: Take, finished: Finished) -> None:
        """The part that was gone on from is finished."""
        self.durable_before += before.writing.actions_durable
        self.parts.append(finished)

    def finish(self, outcome: str, balance: Balance, notes: Sequence[str], continued: bool = False) -> Finished:
        """Close the present part, its losses and what was odd written in it. Raises as `Writing.finish`."""
        self.writing.drain()
        described = replace(
            self.demonstrated,
            outcome=outcome,
            messages_lost=balance.lost,
            gaps=self.gaps(balance),
            more={**self.demonstrated.more, **({NOTES: json.dumps(notes)} if notes else {})},
            continued=continued,
        )
        return self.writing.finish(described)

    def gaps(self, balance: Balance) -> tuple[str, ...]:
        """Sentences about losses that may have falsified an action."""
        return gaps_near_actions(balance.losses, self.stamps)

    def report(self, finished: Finished, balance: Balance, notes: Sequence[str]) -> dict[str, Any]:
        """The reply to the `stop` that finished the last part (CONTRACT, section 1)."""
        reply = {
            "demonstration_id": self.demonstration_id,
            "file": str(finished.file),
            "messages": {topic: count for topic, count in finished.messages.items() if topic not in SHOWN},
            "lost": balance.lost,
            "overflowed": balance.refusals,
            "sha256": finished.sha256,
            "gaps": list(self.gaps(balance)),
            "notes": list(notes),
        }
        if self.parts:
            reply["parts"] = [str(part.file) for part in (*self.parts, finished)]
        return reply
