"""Where each object was put, seen from above in every candidate frame, as one SVG (paper, Fig. 4).

A row an object, in it a panel for each frame in which something is known. Placements that belong to one target have one
color, those that belong to none are hollow; where a cluster is tight, its frame is a good candidate. The frame that was
chosen has a thick border. Equal input gives equal bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import escape

import numpy as np

from learner.inference.targets import Target
from learner.inference.understanding import Understanding
from learner.model.pose import Array
from learner.model.poses import Mask, Rows

PANEL_PX: Final = 150.0
GAP_PX: Final = 22.0
LABEL_PX: Final = 34.0
MARGIN_PX: Final = 16.0
DOT_PX: Final = 3.2
LEAST_SIDE_M: Final = 0.05
"""A panel shows at least so much [m], so that a millimetre of noise does not look like a spread."""
MOST_OBJECTS: Final = 12
MOST_FRAMES: Final = 8
MOST_DOTS: Final = 300
"""Of one object; of more, so many evenly chosen ones are drawn."""
COLORS: Final = ("#2c74b3", "#c0562b", "#3c8d5a", "#93548b", "#b98b16", "#4a9a9a", "#8a4b3a", "#5b6977")
STYLE: Final = (
    "text{font-family:Helvetica,Arial,sans-serif;font-size:11px;fill:#1d2733}.row{font-size:13px;font-weight:bold}"
    "rect{fill:#fbfcfd;stroke:#c4ccd4}.chosen{stroke:#1d2733;stroke-width:2.2}.none{fill:none;stroke:#9aa7b3}"
)


@dataclass(frozen=True)
class Row:
    """The placements of one object: numbers of moves, and the targets among them."""

    object: str
    moves: Rows
    targets: tuple[Target, ...]

    def color(self, move: int) -> str | None:
        """The color of a move's target; None if it belongs to none."""
        found = (number for number, target in enumerate(self.targets) if move in target.members)
        number = next(found, None)
        return None if number is None else COLORS[number % len(COLORS)]


def clusters_svg(understood: Understanding) -> str:
    """The picture; a sentence in it tells what is left out of one that would be too large."""
    rows = _rows(understood)
    frames = understood.moves.samples.frames[:MOST_FRAMES]
    width = 2 * MARGIN_PX + len(frames) * (PANEL_PX + GAP_PX)
    height = 3 * MARGIN_PX + len(rows[:MOST_OBJECTS]) * (PANEL_PX + LABEL_PX + GAP_PX)
    left_out = max(0, len(rows) - MOST_OBJECTS), max(0, len(understood.moves.samples.frames) - MOST_FRAMES)
    note = f"; {left_out[0]} objects and {left_out[1]} frames are not shown" if any(left_out) else ""
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
        f'viewBox="0 0 {width:g} {height:g}" role="img"><style>{STYLE}</style>',
        f'<text x="{MARGIN_PX:g}" y="{MARGIN_PX:g}">seen from above, a panel a frame{note}</text>',
        *(line for number, row in enumerate(rows[:MOST_OBJECTS]) for line in _drawn(number, row, frames, understood)),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _rows(understood: Understanding) -> list[Row]:
    moves = understood.moves
    names = np.unique(moves.object[moves.released]).tolist()
    return [
        Row(
            name,
            np.flatnonzero(moves.released & (moves.object == name)),
            tuple(target for target in understood.targets if target.object == name),
        )
        for name in names
    ]


def _drawn(number: int, row: Row, frames: Sequence[str], understood: Understanding) -> Iterator[str]:
    top = 2 * MARGIN_PX + number * (PANEL_PX + LABEL_PX + GAP_PX)
    meant = ", ".join(f"{t.type} in {t.frame}, spread {100 * t.spread_m:.1f} cm" for t in row.targets) or "no target"
    yield f'<text class="row" x="{MARGIN_PX:g}" y="{top + 12:g}">{escape(row.object)}: {escape(meant)}</text>'
    chosen = {target.frame for target in row.targets}
    shown = row.moves[:: max(1, -(-len(row.moves) // MOST_DOTS))]
    colors = [row.color(int(move)) for move in shown]
    rests = {frame: understood.moves.releases(shown).rest(frame).positions[:, :2] for frame in frames}
    for column, frame in enumerate(frame for frame in frames if not np.isnan(rests[frame]).all()):
        left = MARGIN_PX + column * (PANEL_PX + GAP_PX)
        style = ' class="chosen"' if frame in chosen else ""
        yield f'<text x="{left:g}" y="{top + 29:g}">{escape(frame)}</text>'
        yield f'<rect{style} x="{left:g}" y="{top + LABEL_PX:g}" width="{PANEL_PX:g}" height="{PANEL_PX:g}"/>'
        yield from _dots(rests[frame], colors, left, top + LABEL_PX)


def _dots(points: Array, colors: Sequence[str | None], left: float, top: float) -> Iterator[str]:
    """Points (n, 2) [m] in a panel, x to the right and y up, as large as they fit; unknown ones are not drawn."""
    known: Mask = np.asarray(~np.isnan(points).any(axis=1))
    if not known.any():
        return
    least, most = points[known].min(axis=0), points[known].max(axis=0)
    side_m = max(LEAST_SIDE_M, float((most - least).max()))
    scale = (PANEL_PX - 6 * DOT_PX) / side_m
    offsets = (points - (least + most) / 2) * scale
    for (x, y), color, seen in zip(offsets.tolist(), colors, known.tolist(), strict=True):
        if seen:
            place = f'cx="{left + PANEL_PX / 2 + x:.1f}" cy="{top + PANEL_PX / 2 - y:.1f}" r="{DOT_PX:g}"'
            yield f'<circle {place} fill="{color}"/>' if color else f'<circle class="none" {place}/>'
    scale_text = f"{100 * side_m:.3g} cm"
    yield f'<text x="{left + 4:g}" y="{top + PANEL_PX - 4:g}">{scale_text}</text>'
