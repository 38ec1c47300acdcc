"""The table from above as SVG: objects as they stand, the hand, and where the newest tree brings things.

Drawn in millimetres of the base frame: x to the right, y up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import escape, quoteattr

from learner.model import Pose
from learner.model.pose import Vector
from learner.model.scene import Scene
from pipelines.panel.watch import Frames, Sight

POINT_M: Final = (0.04, 0.04, 0.04)
"""The size [m] in which an object is drawn whose own is not known."""
MARGIN_M: Final = 0.1
LEAST_M: Final = 0.5
"""The view is at least so wide and high [m]."""
OLD_S: Final = 1.0
"""What was not seen for longer [s] is drawn faded."""
HAND_MM: Final = 22
LETTERS: Final = 24
"""So many letters would stand above each other in the picture."""
COLORS: Final = ("#2c74b3", "#c2571a", "#3f8f4f", "#93548b", "#a08410", "#4b5ec9", "#b33a5b", "#2b8c8c")
EMPTY: Final = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 500 500" role="img"></svg>'


@dataclass(frozen=True)
class Destination:
    """Where an object is brought to: a disk of `radius` [m] about `at` in the base frame."""

    object: str
    at: Vector
    radius: float


def table_svg(sight: Sight, frames: Frames, destinations: Sequence[Destination] = ()) -> str:
    """The picture of a moment; without any pose an empty one."""
    if not sight.poses:
        return EMPTY
    left, low, right, high = _view(sight.scene, sight.poses)
    names = sight.objects(frames)
    colors = {name: COLORS[place % len(COLORS)] for place, name in enumerate(names)}
    sizes = {name: size_of(sight.scene, name) for name in names}
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{left:.0f} {-high:.0f} {right - left:.0f} '
        f'{high - low:.0f}" role="img">',
        *_grid(left, low, right, high),
        *(_destination(each, colors.get(each.object, "#555")) for each in destinations),
        *(
            _body(name, sight, sizes[name], colors[name])
            for name in sorted(names, key=lambda name: -_area(sizes[name]))
        ),
        *_hand(sight, frames),
        *(_label(name, sight.poses[name], sizes[name], (high - low) / LETTERS) for name in names),
        "</svg>",
    ]
    return "\n".join(lines)


def size_of(scene: Scene | None, name: str) -> Vector:
    """The size [m] of an object, as known or as a point is drawn."""
    shape = scene.objects.get(name) if scene else None
    return shape.size_m if shape else POINT_M


def _area(size: Vector) -> float:
    return size[0] * size[1]


def _view(scene: Scene | None, poses: Mapping[str, Pose]) -> tuple[float, float, float, float]:
    """Left, low, right and high [mm] of what is drawn: the workspace, and all that stands beside it."""
    xs = [pose.position[0] for pose in poses.values()]
    ys = [pose.position[1] for pose in poses.values()]
    if scene is not None and scene.workspace_m is not None:
        xs += scene.workspace_m[0]
        ys += scene.workspace_m[1]
    (left, right), (low, high) = (_range_mm(values) for values in (xs, ys))
    return left, low, right, high


def _range_mm(values: Sequence[float]) -> tuple[float, float]:
    """A range [mm] around values [m], rounded outwards to decimetres, so that the view does not tremble."""
    middle, half = (min(values) + max(values)) / 2, max(max(values) - min(values), LEAST_M) / 2 + MARGIN_M
    return 100 * math.floor(10 * (middle - half)), 100 * math.ceil(10 * (middle + half))


def _grid(left: float, low: float, right: float, high: float) -> Iterator[str]:
    yield f'<rect x="{left:.0f}" y="{-high:.0f}" width="{right - left:.0f}" height="{high - low:.0f}" fill="#f6f7f9"/>'
    for x in range(int(left), int(right) + 1, 100):
        yield f'<path d="M{x} {-high:.0f}V{-low:.0f}" stroke="#dde1e6" stroke-width="1"/>'
    for y in range(int(low), int(high) + 1, 100):
        yield f'<path d="M{left:.0f} {-y}H{right:.0f}" stroke="#dde1e6" stroke-width="1"/>'


def _body(name: str, sight: Sight, size: Vector, color: str) -> str:
    pose = sight.poses[name]
    x, y = 1000 * pose.position[0], -1000 * pose.position[1]
    width, depth = 1000 * size[0], 1000 * size[1]
    opacity = 0.75 if sight.ages_s[name] < OLD_S else 0.3
    return (
        f'<g transform="translate({x:.1f} {y:.1f}) rotate({-math.degrees(_yaw(pose)):.1f})">'
        f"<title>{escape(name)}</title>"
        f'<rect data-object={quoteattr(name)} x="{-width / 2:.1f}" y="{-depth / 2:.1f}" width="{width:.1f}" '
        f'height="{depth:.1f}" rx="3" fill="{color}" fill-opacity="{opacity}" stroke="{color}" stroke-width="3"/></g>'
    )


def _label(name: str, pose: Pose, size: Vector, height: float) -> str:
    """The name above the body, so that of what lies in a box both are read."""
    x, y = 1000 * pose.position[0], -1000 * pose.position[1] - 1000 * max(size[:2]) / 2
    return (
        f'<text x="{x:.1f}" y="{y - height / 3:.1f}" text-anchor="middle" font-size="{height:.0f}" '
        f'font-family="sans-serif" fill="#111" stroke="#fff" stroke-width="5" paint-order="stroke">'
        f"{escape(name)}</text>"
    )


def _hand(sight: Sight, frames: Frames) -> Iterator[str]:
    pose = sight.poses.get(frames.hand)
    if pose is None:
        return
    x, y = 1000 * pose.position[0], -1000 * pose.position[1]
    gap = 14 if sight.gripper == "open" else 5
    yield (
        f'<g transform="translate({x:.1f} {y:.1f}) rotate({-math.degrees(_yaw(pose)):.1f})" stroke="#111" '
        f'stroke-width="5" fill="none"><title>{escape(frames.hand)}</title><circle r="{HAND_MM}" stroke-width="2"/>'
        f'<path d="M-12 {-gap}H12M-12 {gap}H12"/></g>'
    )


def _destination(each: Destination, color: str) -> str:
    x, y, radius = 1000 * each.at[0], -1000 * each.at[1], 1000 * max(each.radius, 0.01)
    return (
        f'<g stroke="{color}" fill="none"><title>{escape(each.object)}</title><circle cx="{x:.1f}" cy="{y:.1f}" '
        f'r="{radius:.1f}" stroke-width="3" stroke-dasharray="8 6"/>'
        f'<path d="M{x - 8:.1f} {y:.1f}h16M{x:.1f} {y - 8:.1f}v16" stroke-width="3"/></g>'
    )


def _yaw(pose: Pose) -> float:
    """The turn [rad] about the vertical, by where the own x-axis points as seen from above."""
    ahead = [to - of for to, of in zip(pose.apply((1.0, 0.0, 0.0)), pose.position, strict=True)]
    return math.atan2(ahead[1], ahead[0])
