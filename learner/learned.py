"""What a method returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from learner.model import Demonstration, Tree
from learner.model.names import identifier

if TYPE_CHECKING:  # a plan makes trees, and names them by main_id
    from learner.plan import Plan


@dataclass(frozen=True)
class Learned:
    """A tree, a report for the manifest (JSON-able), and notes: sentences on what is not known or was left out."""

    tree: Tree
    report: dict[str, Any]
    notes: tuple[str, ...]
    certificate: dict[str, Any] | None = None
    """What was proven of the tree: see learner.proof.Certificate."""
    plan: Plan | None = field(default=None, repr=False, compare=False)
    """Where the method can make the tree again with repairs: from what."""


def main_id(demonstrations: Sequence[Demonstration]) -> str:
    """The ID of the main tree: the task's name; one that begins with a digit gets a 'T' before it."""
    name = identifier(demonstrations[0].task)
    return name if not name[0].isdigit() else f"T{name}"
