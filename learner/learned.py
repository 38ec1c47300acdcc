"""What a method returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from learner.model import Definition, Demonstration, Node, Tree
from learner.model.names import identifier


@dataclass(frozen=True)
class Learned:
    """A tree, a report for the manifest (JSON-able), and notes: sentences on what is not known or was left out."""

    tree: Tree
    report: dict[str, Any]
    notes: tuple[str, ...]


def main_definition(demonstrations: Sequence[Demonstration], root: Node) -> Definition:
    """The main tree, named after the task; a name that begins with a digit gets a 'T' before it."""
    name = identifier(demonstrations[0].task)
    return Definition(name if not name[0].isdigit() else f"T{name}", root)
