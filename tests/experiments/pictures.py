"""The experiments in pictures (matplotlib, the extra `experiments`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from learner.execution.ticking import Status, Ticker
from learner.learning import learn
from learner.model.upright import Spot
from learner.relations.knowledge import Knowledge
from learner.simulation.kinematic_world import WORKSPACE_M, KinematicWorld

from . import report
from .demonstrator import demonstrated
from .disturbances import wrong_tower
from .scenarios import BASE, SCENARIOS, Scenario

Result = dict[str, Any]

COLOURS: Final = {"A": "#c44e52", "B": "#dd8452", "C": "#ccb974", "D": "#55a868", "E": "#4c72b0", "F": "#8172b3"}
GREY: Final = "#b0b0b0"


def draw_all(success: Sequence[Result], users: Sequence[Result], size: Sequence[Result], folder: Path) -> list[str]:
    """Draw every picture into `folder`; Markdown that shows them."""
    mpl.use("Agg")
    mpl.rcParams.update({"svg.hashsalt": "treewright", "font.size": 9, "axes.spines.top": False,
                         "axes.spines.right": False})  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    pictures: dict[str, tuple[str, Callable[[], Figure]]] = {
        "clusters": ("Where D comes to rest in the tower of Hanoi, in each candidate frame, ten demonstrations; "
                     "one colour for each time that D is placed", clusters),
        "demonstrations": ("Success against the number of demonstrations", lambda: by_demonstrations(success)),
        "users": ("Success by user", lambda: by_user(users)),
        "sizes": ("Size against the number of demonstrations, kitting", lambda: by_size(size)),
        "tradeoff": ("Size against reactivity: the paper names the trade-off", lambda: tradeoff(success)),
        "filmstrip": ("A recovery: the tower was built wrongly before the robot began", filmstrip),
    }  # fmt: skip
    return [_drawn(folder, name, caption, draw) for name, (caption, draw) in pictures.items()]


def _drawn(folder: Path, name: str, caption: str, draw: Callable[[], Figure]) -> str:
    figure = draw()
    path = folder / f"{name}.svg"
    figure.savefig(path, bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)
    return f"![{caption}]({path.as_posix()})\n\n*{caption}.*"


def clusters() -> Figure:
    """The paper's figure: the rests of one object in every candidate frame."""
    frames = (BASE, "E", "F")
    figure, axes = plt.subplots(1, len(frames), figsize=(9, 3))
    releases = [
        [action for action in demonstration.actions if action.type != "pick" and action.object == "D"]
        for demonstration in demonstrated(SCENARIOS["hanoi"], 10, 7)
    ]
    for frame, axis in zip(frames, axes, strict=True):
        for time in range(min(len(actions) for actions in releases)):
            rests = [actions[time].rest[frame].position for actions in releases if actions[time].rest]
            axis.scatter(*np.array(rests)[:, :2].T, s=14, label=f"{time + 1}. time", alpha=0.8)
        axis.set(title=f"in {frame}", xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axis.set_adjustable("datalim")
    axes[0].legend(frameon=False)
    figure.tight_layout()
    return figure


def _percent(runs: Sequence[Result]) -> float:
    return 100 * sum(run["verdict"] == "done" for run in runs) / len(runs) if runs else math.nan


def by_demonstrations(success: Sequence[Result]) -> Figure:
    """Lines: runs in which no way out had to be found, and those in which one had."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 3), sharey=True)
    for axis, keep, title in zip(axes, (report.plain, report.beyond), ("done", "recovery"), strict=True):
        for (method, users), cells in report.grouped(success, "method", "users").items():
            by_count = sorted(report.grouped(cells, "demonstrations").items())
            shares = [_percent(report.runs_of(some, keep)) for _, some in by_count]
            axis.plot([count for (count,), _ in by_count], shares, marker="o", label=f"{method}, {users}")
        axis.set(title=title, xlabel="demonstrations", ylim=(0, 103))
    axes[0].set_ylabel("runs that succeed [%]")
    axes[1].legend(frameon=False)
    return figure


def by_user(users: Sequence[Result]) -> Figure:
    """Bars for each user, both methods beside each other."""
    figure, axis = plt.subplots(figsize=(9, 3))
    methods = sorted({result["method"] for result in users})
    names = list(dict.fromkeys(result["users"] for result in users))
    for index, method in enumerate(methods):
        shares = [_percent(report.runs_of([r for r in users if (r["users"], r["method"]) == (name, method)],
                                          report.plain)) for name in names]  # fmt: skip
        axis.bar(np.arange(len(names)) + 0.4 * index, shares, width=0.38, label=method)
    axis.set_xticks(np.arange(len(names)) + 0.2, names, rotation=45, ha="right")
    axis.set_ylabel("runs that succeed [%]")
    axis.legend(frameon=False, loc="lower right")
    return figure


def by_size(size: Sequence[Result]) -> Figure:
    """Nominal nodes against demonstrations, logarithmic."""
    figure, axis = plt.subplots(figsize=(5, 3))
    for (scenario, method), cells in report.grouped([r for r in size if "nodes" in r], "scenario", "method").items():
        axis.plot(
            [r["demonstrations"] for r in cells], [r["nodes"] for r in cells], "o-", label=f"{scenario}, {method}"
        )
    axis.set(xlabel="demonstrations", ylabel="nodes", xscale="log", yscale="log")
    axis.legend(frameon=False, fontsize=8)
    return figure


def tradeoff(success: Sequence[Result]) -> Figure:
    """A point for each task and method: all nodes, and the share of all disturbed runs that succeed."""
    figure, axis = plt.subplots(figsize=(5, 3))
    for (method,), cells in report.grouped([r for r in success if "nodes" in r], "method").items():
        points = [
            (np.mean([r["nodes"] + r["nodes_recovery"] for r in some]),
             _percent(report.runs_of(some, lambda run: run["disturbed"] is not None)))
            for some in report.grouped(cells, "scenario").values()
        ]  # fmt: skip
        axis.scatter(*np.array(points).T, label=method, alpha=0.8)
    axis.set(xlabel="nodes with recovery", ylabel="disturbed runs that succeed [%]", xscale="log")
    axis.legend(frameon=False)
    return figure


def filmstrip(seed: int = 3, count: int = 8) -> Figure:
    """One run of the learned tree, a view after each release."""
    scenario = SCENARIOS["tower_and_box"]
    rng = np.random.default_rng(seed)
    learned = learn(demonstrated(scenario, 5, seed))
    root = learned.tree.flattened()
    world = KinematicWorld(
        scenario.objects, scenario.draw_start(rng), rng, knowledge=Knowledge.of(root, learned.grasps)
    )
    wrong_tower(world, scenario, rng)
    frames = _views(world, Ticker(root, world))
    shown = [frames[round(index)] for index in np.linspace(0, len(frames) - 1, min(count, len(frames)))]
    figure, axes = plt.subplots(2, math.ceil(len(shown) / 2), figsize=(9, 4))
    for axis in axes.flat:
        axis.axis("off")
    for axis, (step, spots) in zip(axes.flat, shown, strict=False):
        _view(axis, scenario, spots, f"{step * 0.1:.1f} s")
    return figure


def _views(world: KinematicWorld, ticker: Ticker) -> list[tuple[int, dict[str, Spot]]]:
    """The spots at the start and after each release, until the tree has said SUCCESS for a second."""
    views, held, said = [(0, dict(world.table.spots))], world.held, 0
    while said < 10 and world.steps < 2000:
        said = said + 1 if ticker.tick() is Status.SUCCESS else 0
        world.step()
        if held and world.held is None:
            views.append((world.steps, dict(world.table.spots)))
        held = world.held
    return views


def _view(axis: Axes, scenario: Scenario, spots: dict[str, Spot], title: str) -> None:
    """Seen from the robot's front, from above: what stands higher is drawn later and further up."""
    for name, spot in sorted(spots.items(), key=lambda item: item[1].z):
        half_x, half_y, half_z = (size / 2 for size in scenario.objects[name].shape.size_m)
        ground = [spot.point(x, y) for x, y in ((-half_x, -half_y), (half_x, -half_y), (half_x, half_y),
                                                (-half_x, half_y))]  # fmt: skip
        colour = COLOURS.get(name, "none")
        for height in (spot.z - half_z, spot.z + half_z):
            face = [_seen_at(x, y, height) for x, y in ground]
            axis.add_patch(Polygon(face, facecolor=colour, edgecolor="black", linewidth=0.7))
        middle = _seen_at(spot.x, spot.y, spot.z + half_z)
        axis.annotate(name, middle, ha="center", va="center", fontsize=6, color="black" if colour == "none" else "w")
    (x0, x1), (y0, y1) = WORKSPACE_M
    axis.add_patch(Polygon([_seen_at(x, y, 0.0) for x, y in ((x0, y0), (x0, y1), (x1, y1), (x1, y0))],
                           facecolor="#f4f1ea", edgecolor=GREY, zorder=0))  # fmt: skip
    axis.set(xlim=(-0.7, 0.7), ylim=(0.1, 0.95), aspect="equal")
    axis.set_title(title, fontsize=8)


def _seen_at(x: float, y: float, z: float) -> tuple[float, float]:
    """Oblique projection: across, and up the page with depth and height."""
    return -y, 0.7 * x + 1.2 * z
