"""A tree as lines for a person: one for each placement, each unfolded to its parts, to the last leaf.

A line stands for a node; its `index` is the node's place in the flattened tree, depth first, from 0: by it a controller
tells the statuses of a run. Parts are looked up when a line is unfolded, since trees have thousands of nodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from learner.model.tree import Node, Tree, Value, is_recovery
from learner.model.vocabulary import LEAVES, REFERENCE, SUBTREE
from pipelines.panel.sentences import SENTENCES, Voice

RELEASES: Final = ("Place", "Drop")
Values = Mapping[str, Value]


@dataclass(frozen=True)
class Line:
    """A node of a tree with its ports filled in. `recovers` where it stands for recovery alone, `inside` where a line
    above it is one placement.
    """

    index: int
    node: Node
    values: Values
    recovers: bool
    inside: bool = False

    @property
    def ports(self) -> dict[str, Value]:
        """The values of the node's ports, those of its SubTree filled in."""
        return {name: _filled(value, self.values) for name, value in self.node.ports}


class Folding:
    """The lines of one tree."""

    def __init__(self, tree: Tree) -> None:
        self._definitions = tree.definitions
        self._sizes: dict[str, int] = {}
        self.root: Final = self._line(0, tree.main.root, {}, False)

    def size(self, line: Line) -> int:
        """How many nodes a line stands for, itself counted."""
        return self._size(line.node)

    def parts(self, line: Line) -> list[Line]:
        """The lines into which a line unfolds; none for a leaf."""
        lines, index = [], line.index + 1
        inside = line.inside or self.is_placement(line)
        for child in line.node.children:
            lines.append(replace(self._line(index, child, line.values, line.recovers), inside=inside))
            index += self._size(child)
        return lines

    def moves(self, line: Line) -> list[tuple[str, dict[str, Value]]]:
        """The kinds and ports of the Picks, Places and Drops below a line, those that only recover left out."""
        return list(self._moves(line.node, line.values, line.recovers))

    def is_placement(self, line: Line) -> bool:
        """Whether one thing is released somewhere below the line."""
        return self._releases(line) == 1

    def is_folded(self, line: Line) -> bool:
        """Whether a line is shown folded at first: one placement, or what only recovers, or a leaf."""
        return line.recovers or self._releases(line) <= 1

    def _releases(self, line: Line) -> int:
        return sum(kind in RELEASES for kind, _ in self.moves(line))

    def _moves(self, node: Node, values: Values, recovers: bool) -> Iterator[tuple[str, dict[str, Value]]]:
        line = self._line(0, node, values, recovers)
        if line.recovers:
            return
        if line.node.kind in ("Pick", *RELEASES):
            yield line.node.kind, line.ports
        for child in line.node.children:
            yield from self._moves(child, line.values, line.recovers)

    def _line(self, index: int, node: Node, values: Values, recovers: bool) -> Line:
        """The line of a node; a SubTree is its own root, as in the flattened tree."""
        recovers = recovers or is_recovery(node)
        while node.kind == SUBTREE:
            values = {name: _filled(value, values) for name, value in node.ports}
            node = self._definitions[str(node.id)].root
            recovers = recovers or is_recovery(node)
        return Line(index, node, values, recovers)

    def _size(self, node: Node) -> int:
        if node.kind != SUBTREE:
            return 1 + sum(self._size(child) for child in node.children)
        name = str(node.id)
        if name not in self._sizes:
            self._sizes[name] = self._size(self._definitions[name].root)
        return self._sizes[name]


class Told:
    """The lines of a tree in words."""

    def __init__(self, folding: Folding, voice: Voice) -> None:
        self._folding, self._voice = folding, voice

    def line(self, line: Line) -> str:
        """What a line does or asks, in one sentence; of one placement the two moves, as the paper writes them."""
        voice, kind = self._voice, line.node.kind
        if line.recovers and kind not in LEAVES:
            return voice("recovery", count=self._folding.size(line))
        if kind in LEAVES:
            return self._leaf(kind, line.ports)
        if not line.inside and self._folding.is_placement(line):
            return self._placement(self._folding.moves(line))
        return voice(f"node_{kind}") if f"node_{kind}" in SENTENCES else kind

    def ports(self, line: Line) -> str:
        """All ports of a leaf with their numbers."""
        return "\n".join([line.node.kind, *(f"{name} = {_shown(value)}" for name, value in sorted(line.ports.items()))])

    def _placement(self, moves: list[tuple[str, dict[str, Value]]]) -> str:
        release, ports = next(move for move in moves if move[0] in RELEASES)
        picked = any(kind == "Pick" and each.get("object") == ports["object"] for kind, each in moves)
        facts = {name: ports[name] for name in ("object", "frame")}
        return self._voice(
            "pick_and_release" if picked else "release",
            kind=self._voice(release.lower()),
            at=_millimetres(ports),
            **facts,
        )

    def _leaf(self, kind: str, ports: dict[str, Value]) -> str:
        key = f"node_{kind}" + ("_none" if ports.get("object") == "none" else "")
        if key not in SENTENCES:
            return " ".join([kind, *(f"{name}={_shown(value)}" for name, value in sorted(ports.items()))])
        facts: dict[str, Any] = {name: value for name, value in ports.items() if not isinstance(value, tuple)}
        if "state" in facts:
            facts["state"] = self._voice(f"gripper_{facts['state']}")
        if isinstance(radius := ports.get("radius"), float):
            facts["radius"] = f"{1000 * radius:.0f}"
        return self._voice(key, **(facts | {"at": _millimetres(ports)}))


def _filled(value: Value, values: Values) -> Value:
    reference = REFERENCE.fullmatch(value) if isinstance(value, str) else None
    return values.get(reference[1], value) if reference else value


def _millimetres(ports: Mapping[str, Value]) -> str:
    """The position of a leaf [mm]; one that is found while the tree runs by its name."""
    position = ports.get("position", "")
    if not isinstance(position, tuple):
        return str(position)
    return "(" + ", ".join(str(round(1000 * number)) for number in position) + ")"


def _shown(value: Value) -> str:
    return "; ".join(f"{number:.6g}" for number in value) if isinstance(value, tuple) else str(value)
