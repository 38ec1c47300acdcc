"""A tree as a picture: one self-contained SVG, read from left to right, children from top to bottom in their order.

A leaf takes a line, so the picture of a large tree is long, not wide. SubTrees are drawn where they are used, filled
in, their name above; what only recovers is one box that tells how much it hides. Every box tells its ports in full to
who points at it. Equal trees give equal bytes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final
from xml.sax.saxutils import escape

from learner.model.tree import Node, Tree, Value, is_recovery
from learner.model.vocabulary import CONDITIONS, LEAVES, REFERENCE, SUBTREE

SYMBOLS: Final = {
    "Sequence": "→",
    "ReactiveSequence": "→ ↻",
    "Fallback": "?",
    "ReactiveFallback": "? ↻",
    "Inverter": "not",
    "ForceSuccess": "succeed",
    "ForceFailure": "fail",
}
LEGEND: Final = "→ sequence · ? fallback · ↻ reactive: asks its children from the first one again at every tick"

HEIGHT_PX: Final = 24.0
ROW_GAP_PX: Final = 7.0
COLUMN_GAP_PX: Final = 26.0
CAPTION_PX: Final = 14.0
MARGIN_PX: Final = 24.0
TITLE_PX: Final = 72.0
CONTROL_PX: Final = 44.0
DECORATOR_PX: Final = 66.0
PADDING_PX: Final = 9.0
HEADER_PX: Final = 520.0
WIDE: Final = frozenset("ABCDEFGHJKLMNOPQRSTUVWXYZmw_@%")
STYLE: Final = """
text{font-family:Helvetica,Arial,sans-serif;font-size:12.5px;fill:#1d2733}
.title{font-size:18px;font-weight:bold}
.detail{font-size:11px;fill:#5b6977}
.caption{font-size:10.5px;font-style:italic;fill:#6d7b88}
.symbol{font-size:14px;font-weight:bold;text-anchor:middle}
.word{font-weight:bold;text-anchor:middle}
.link{fill:none;stroke:#9aa7b3;stroke-width:1.2}
rect{stroke-width:1.2}
.control{fill:#eceff3;stroke:#5b6977}
.condition{fill:#fdf3d7;stroke:#b98b16}
.action{fill:#ddeefb;stroke:#2c74b3}
.recovery{fill:#f7e9f5;stroke:#93548b;stroke-dasharray:5 3}
"""


@dataclass
class Box:
    """A drawn node: what it says, and, once laid out, the corner at which it begins [px]."""

    style: str
    label: str
    detail: str = ""
    tip: str = ""
    caption: str = ""
    children: list[Box] = field(default_factory=list)
    x: float = 0.0
    y: float = 0.0

    @property
    def width(self) -> float:
        """The box's own width [px]."""
        if self.style == "control":
            return DECORATOR_PX if len(self.label) > 3 else CONTROL_PX
        return math.ceil(
            _width(self.label, 12.5) + _width(self.detail, 11.0) + 2 * PADDING_PX + (8 if self.detail else 0)
        )

    @property
    def right(self) -> float:
        """Where the box, or the caption above it, ends [px]."""
        return self.x + max(self.width, _width(self.caption, 10.5))

    @property
    def middle(self) -> float:
        """The height at which links arrive and leave [px]."""
        return self.y + HEIGHT_PX / 2

    def walk(self) -> Iterator[Box]:
        """This box and all below it."""
        yield self
        for child in self.children:
            yield from child.walk()


def to_svg(tree: Tree) -> str:
    """The picture of `tree`, with its ID and sizes as the title."""
    root = _box(tree.main.root, {}, tree)
    bottom = _place(root, MARGIN_PX, MARGIN_PX + TITLE_PX) + MARGIN_PX
    boxes = list(root.walk())
    width = max(*(box.right for box in boxes), MARGIN_PX + HEADER_PX, MARGIN_PX + _width(tree.main.id, 18)) + MARGIN_PX
    recovery = f", and {tree.nodes_recovery} that only recover" if tree.nodes_recovery else ""
    title = escape(tree.main.id)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{bottom:g}" '
        f'viewBox="0 0 {width:g} {bottom:g}" role="img">',
        f"<title>{title}</title><style>{STYLE}</style>",
        '<rect width="100%" height="100%" fill="#ffffff"/>',
        _text("title", MARGIN_PX, MARGIN_PX + 14, tree.main.id),
        _text("detail", MARGIN_PX, MARGIN_PX + 33, f"{tree.nodes} nodes{recovery}"),
        _text("detail", MARGIN_PX, MARGIN_PX + 49, LEGEND),
        *(_link(box, child) for box in boxes for child in box.children),
        *(_shape(box) for box in boxes),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _box(node: Node, values: Mapping[str, Value], tree: Tree) -> Box:
    ports = {name: _resolved(value, values) for name, value in node.ports}
    tip = "\n".join([node.kind, *(f"{name} = {_shown(value)}" for name, value in sorted(ports.items()))])
    if node.kind == SUBTREE:
        return _subtree_box(node, ports, tree)
    if node.kind in LEAVES:
        style = "condition" if node.kind in CONDITIONS else "action"
        return Box(style, _label(node.kind, ports), _detail(ports), tip)
    children = [_box(child, values, tree) for child in node.children]
    return Box("control", SYMBOLS[node.kind], tip=tip, children=children)


def _subtree_box(node: Node, ports: Mapping[str, Value], tree: Tree) -> Box:
    values = [ports[name] for name in sorted(ports, key=lambda name: (name != "object", name))]
    name = " ".join([str(node.id), *dict.fromkeys(value for value in values if isinstance(value, str))])
    if is_recovery(node):
        return Box("recovery", name, f"{_size(node, tree)} nodes", f"{node.id}: recovers what was not demonstrated")
    box = _box(tree.definitions[str(node.id)].root, ports, tree)
    box.caption = f"{name} > {box.caption}" if box.caption else name
    return box


def _size(node: Node, tree: Tree) -> int:
    if node.kind == SUBTREE:
        return _size(tree.definitions[str(node.id)].root, tree)
    return 1 + sum(_size(child, tree) for child in node.children)


def _resolved(value: Value, values: Mapping[str, Value]) -> Value:
    reference = REFERENCE.fullmatch(value) if isinstance(value, str) else None
    return values.get(reference[1], value) if reference else value


def _label(kind: str, ports: Mapping[str, Value]) -> str:
    words = [kind, *(str(ports[name]) for name in ("state", "object") if name in ports)]
    return " ".join(words + (["in", str(ports["frame"])] if "frame" in ports else []))


def _detail(ports: Mapping[str, Value]) -> str:
    position = ports.get("position")
    place = "(" + ", ".join(f"{number:.3f}" for number in position) + ")" if isinstance(position, tuple) else ""
    radius = ports.get("radius")
    return f"{place} ± {100 * radius:.3g} cm" if isinstance(radius, float) else place


def _shown(value: Value) -> str:
    return "; ".join(f"{number:.6g}" for number in value) if isinstance(value, tuple) else str(value)


def _place(box: Box, x: float, top: float) -> float:
    """Lay out the box and all below it from the corner (x, top) on; returns where the next one may begin [px]."""
    box.x = x
    top += CAPTION_PX if box.caption else 0.0
    if not box.children:
        box.y = top
        return top + HEIGHT_PX + ROW_GAP_PX
    next_top = top
    for child in box.children:
        next_top = _place(child, box.right + COLUMN_GAP_PX, next_top)
    box.y = (box.children[0].y + box.children[-1].y) / 2
    return next_top


def _link(parent: Box, child: Box) -> str:
    start, end = parent.x + parent.width, child.x
    bend = end - COLUMN_GAP_PX / 2
    return (
        f'<path class="link" d="M{start:g} {parent.middle:g}H{bend - 8:g}'
        f'C{bend + 4:g} {parent.middle:g} {bend - 4:g} {child.middle:g} {end:g} {child.middle:g}"/>'
    )


def _shape(box: Box) -> str:
    rounding = 12 if box.style == "condition" else 3
    rect = f'<rect class="{box.style}" x="{box.x:g}" y="{box.y:g}" width="{box.width:g}" height="24" rx="{rounding}"/>'
    baseline = box.y + 16.5
    if box.style == "control":
        text = _text("word" if len(box.label) > 3 else "symbol", box.x + box.width / 2, baseline, box.label)
    else:
        detail = f'<tspan class="detail" dx="8">{escape(box.detail)}</tspan>' if box.detail else ""
        text = f'<text x="{box.x + PADDING_PX:g}" y="{baseline:g}">{escape(box.label)}{detail}</text>'
    caption = _text("caption", box.x, box.y - 4, box.caption) if box.caption else ""
    return f"<g><title>{escape(box.tip)}</title>{rect}{text}{caption}</g>"


def _text(style: str, x: float, y: float, content: str) -> str:
    return f'<text class="{style}" x="{x:g}" y="{y:g}">{escape(content)}</text>'


def _width(text: str, size_px: float) -> float:
    """An upper estimate of how wide a text is [px]: fonts differ between viewers."""
    return size_px * sum(0.72 if character in WIDE else 0.56 for character in text)
