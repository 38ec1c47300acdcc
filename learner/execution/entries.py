"""The entries of a tree that is ticked: what its leaves have written, and leaves with that filled in.

A leaf that reads an entry which nobody has written yet fails, as in BehaviorTree.CPP. An action reads its ports when it
starts, and keeps what it read until it ends; so its node stays the same one while it runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from learner.model.tree import Node, Value, is_reference
from learner.model.vocabulary import outputs_of

MOST: Final = 64
"""So many different nodes are kept of each leaf."""

Found = Mapping[str, Value]
"""What a query has found: its output ports."""


class Entries:
    """The values of the entries of one tree, by reference."""

    def __init__(self) -> None:
        self._values: dict[Value, Value] = {}

    def bound(self, node: Node) -> Callable[[], Node | None]:
        """What gives the leaf `node` with the entries that it reads filled in; None while one is not written.

        Equal entries give the same node, so that it may be known by its identity.
        """
        outputs = outputs_of(node.kind)
        read = [(name, value) for name, value in node.ports if name not in outputs and is_reference(value)]
        if not read:
            return lambda: node
        known: dict[tuple[Value, ...], Node] = {}

        def fill() -> Node | None:
            try:
                values = tuple(self._values[reference] for _, reference in read)
            except KeyError:
                return None
            if values not in known:
                if len(known) >= MOST:
                    known.clear()
                filled = dict(zip((name for name, _ in read), values, strict=True))
                known[values] = Node(node.kind, tuple((name, filled.get(name, value)) for name, value in node.ports))
            return known[values]

        return fill

    def write(self, node: Node, found: Found) -> None:
        """Write what a query has found to the entries that its output ports name."""
        for name in outputs_of(node.kind):
            self._values[node.port(name)] = found[name]
