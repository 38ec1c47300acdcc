"""A tree on a page: lines that unfold by a click, and that are coloured as their nodes tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from nicegui import ui
from nicegui.element import Element

from pipelines.panel.folding import Folding, Line, Told

Evidence = Callable[[Line], str]
"""What is known of a line beside the tree; empty where nothing is."""


class TreeView:
    """Builds the lines of a tree where it is made; parts are built when they are unfolded first."""

    def __init__(self, folding: Folding, told: Told, evidence: Evidence = lambda line: "") -> None:
        self._folding, self._told, self._evidence = folding, told, evidence
        self._rows: dict[int, Element] = {}
        self._painted: dict[int, str] = {}
        self._shown: Mapping[int, str] = {}
        self._frame = ui.element("div").classes("tw-tree")
        with self._frame:
            self._build(folding.root)

    def show_recovery(self, shown: bool) -> None:
        """Show the lines that only recover, or leave them away."""
        self._frame.classes(**{"add" if shown else "remove": "tw-with-recovery"})

    def paint(self, statuses: Mapping[int, str]) -> None:
        """Colour the lines that are shown by the statuses of their nodes, those without one plainly."""
        self._shown = statuses
        for index, row in self._rows.items():
            status = statuses.get(index, "")
            if self._painted.get(index, "") != status:
                row.classes(remove=self._painted.get(index, ""), add=status)
                self._painted[index] = status

    def _build(self, line: Line) -> None:
        leaf, folded = not line.node.children, self._folding.is_folded(line)
        with ui.element("div").classes("tw-node tw-recovers" if line.recovers else "tw-node"):
            row = ui.element("div").classes("tw-row tw-leaf" if leaf else "tw-row")
            parts = ui.element("div").classes("tw-parts")
        with row:
            arrow = ui.label("" if leaf else "▸" if folded else "▾").classes("tw-arrow")
            ui.label(self._told.line(line))
        self._rows[line.index] = row
        parts.set_visibility(not folded)
        if not folded:
            self._fill(line, parts)
        row.props("role=button tabindex=0").on("click", lambda: self._turn(line, parts, arrow))

    def _turn(self, line: Line, parts: Element, arrow: ui.label) -> None:
        """Unfold what is folded, and fold what is unfolded."""
        if not parts.default_slot.children:
            self._fill(line, parts)
            self.paint(self._shown)
            parts.set_visibility(True)
        else:
            parts.set_visibility(not parts.visible)
        arrow.set_text("" if not line.node.children else "▾" if parts.visible else "▸")

    def _fill(self, line: Line, parts: Element) -> None:
        said = self._evidence(line)
        with parts:
            if said:
                ui.label(said).classes("tw-evidence")
            if not line.node.children:
                ui.label(self._told.ports(line)).classes("tw-ports")
            for part in self._folding.parts(line):
                self._build(part)
