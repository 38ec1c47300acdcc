"""What shops really teach, as data: the bodies, what a demonstrator does from a start, and the truth of what is done.

Unlike the tasks of `scenarios`, what is done may depend on how things stood, on what they are, or on the way: a task is
a script that is made for each start, and a truth that knows the start and every place where something was let go.
Lengths [m], angles [rad].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from learner.model import ObjectShape
from learner.model.pose import Vector
from learner.simulation.gravity import Body, Solid, Spot, Table
from learner.simulation.script import ScriptedMove

from .scenarios import BASE

Spots = Mapping[str, Spot]
Script = tuple[ScriptedMove, ...]


@dataclass(frozen=True)
class Course:
    """How a run went: where everything stood at its `start`, and stands now (`spots`), and what was let go where
    (`rested`, in order: the object, and all spots once it lay still)."""

    start: Spots
    spots: Spots
    rested: Sequence[tuple[str, Spots]] = ()

    def at(self, name: str, frame: str, at: Vector, within_m: float = 0.04, spots: Spots | None = None) -> bool:
        """Whether an object lies at a place of a frame, by its origin, in the end or at other spots."""
        now = self.spots if spots is None else spots
        here = now[name] if frame == BASE else now[frame].relative(now[name])
        return math.dist((here.x, here.y, here.z), at) <= within_m

    def turned(self, name: str, frame: str, yaw: float, period: float = 2 * math.pi, within: float = 0.45) -> bool:
        """Whether an object is turned to a yaw of a frame, modulo the period of its symmetry."""
        here = self.spots[name].yaw - (0.0 if frame == BASE else self.spots[frame].yaw)
        return abs(math.remainder(here - yaw, period)) <= within

    def within(self, name: str, frame: str) -> bool:
        """Whether an object lies in a container, 10 cm high at the most."""
        here = self.spots[frame].relative(self.spots[name])
        return max(abs(here.x), abs(here.y)) < HALF_BIN and abs(here.z) < 0.06

    def visited(self, name: str, frame: str, at: Vector) -> bool:
        """Whether an object was let go there before the last time that it was let go."""
        own = [spots for moved, spots in self.rested if moved == name]
        return any(self.at(name, frame, at, spots=spots) for spots in own[:-1])


@dataclass(frozen=True)
class ShopTask:
    """A task of a shop: `script` is what a demonstrator does, `done` the truth.

    `needs` says in a word or two what a tree has to express beyond places in frames. `upon`: what stands on what at
    the start (object, below). `strangers` are objects that no demonstration has, and every run.
    """

    name: str
    needs: str
    objects: Mapping[str, Body]
    script: Callable[[Spots, np.random.Generator], Script]
    done: Callable[[Course], bool]
    upon: tuple[tuple[str, str], ...] = ()
    strangers: Mapping[str, Body] = field(default_factory=dict)
    accuracy_m: float | None = None


@dataclass(frozen=True)
class Fixture(Body):
    """A block with a pocket in the middle of its top, `pocket_m` long, wide and deep."""

    pocket_m: Vector = (0.0, 0.0, 0.0)

    @cached_property
    def solids(self) -> tuple[Solid, ...]:
        """A floor, and four walls around the pocket."""
        half_x, half_y, half_z = (size / 2 for size in self.shape.size_m)
        in_x, in_y, deep = self.pocket_m[0] / 2, self.pocket_m[1] / 2, self.pocket_m[2]
        wall_x, wall_y = (half_x - in_x) / 2, (half_y - in_y) / 2
        sides = [Solid(side * (in_x + wall_x), 0.0, wall_x, half_y, -half_z, half_z) for side in (-1, 1)]
        ends = [Solid(0.0, side * (in_y + wall_y), half_x, wall_y, -half_z, half_z) for side in (-1, 1)]
        return (Solid(0.0, 0.0, half_x, half_y, -half_z, half_z - deep), *sides, *ends)


def _body(size_m: Vector, symmetry: str = "none", **told: object) -> Body:
    return Body(ObjectShape(size_m, symmetry, **told))  # type: ignore[arg-type]  # data


CUBE = _body((0.05, 0.05, 0.05), "cube")
PART = _body((0.08, 0.04, 0.04))
LONG = _body((0.16, 0.04, 0.03))
BAR = _body((0.12, 0.05, 0.04), "box")
TRAY = _body((0.26, 0.12, 0.02), fixed=True)
PLATE = _body((0.1, 0.07, 0.008))
MAT = _body((0.14, 0.14, 0.01), fixed=True)
LID = _body((0.14, 0.08, 0.02), "box")
HALF_BIN = 0.125
BIN = Body(ObjectShape((2 * HALF_BIN, 2 * HALF_BIN, 0.08), "box", open=True), "open_box")
CASE = Body(ObjectShape((0.15, 0.15, 0.08), "box", open=True), "open_box")
CRATE = Fixture(ObjectShape((0.15, 0.09, 0.08), "box", open=True), pocket_m=(0.11, 0.06, 0.07))
VISE = Fixture(ObjectShape((0.16, 0.12, 0.06), fixed=True), pocket_m=(0.088, 0.048, 0.025))
NEST = Fixture(ObjectShape((0.2, 0.2, 0.06), fixed=True), pocket_m=(0.07, 0.07, 0.02))
SCREW = Body(ObjectShape((0.03, 0.03, 0.03), "cube", kind="screw"))
NUT = Body(ObjectShape((0.035, 0.035, 0.02), "box", kind="nut"))
ON_TRAY = 0.035
"""Of a cube upon the tray; of a part 5 mm less."""
IN_CRATE = -0.005
CORNER = 0.095
SLOTS = (-CORNER, 0.0, CORNER)


def put(name: str, frame: str, at: Vector, yaw: float | None = None) -> ScriptedMove:
    return ScriptedMove("place", name, frame, at, yaw)


def drop(name: str, frame: str, at: Vector) -> ScriptedMove:
    return ScriptedMove("drop", name, frame, at, None)


def any_yaw(rng: np.random.Generator) -> float:
    return float(rng.uniform(-math.pi, math.pi))


def somewhere(name: str, body: Body, spots: Spots, rng: np.random.Generator) -> ScriptedMove:
    """Anywhere on the table."""
    x, y = rng.uniform([0.25, -0.4], [0.75, 0.4]).tolist()
    return put(name, BASE, (x, y, body.half_height), any_yaw(rng))


def _middle(spots: Spots, one: str, other: str) -> tuple[float, float]:
    a, b = spots[one], spots[other]
    return (a.x + b.x) / 2, (a.y + b.y) / 2


def _between(spots: Spots, rng: np.random.Generator) -> Script:
    return (put("B", BASE, (*_middle(spots, "A", "C"), PART.half_height), any_yaw(rng)),)


def _beside(spots: Spots, rng: np.random.Generator) -> Script:
    return (put("B", BASE, (spots["A"].x + 0.13, spots["A"].y, PART.half_height), any_yaw(rng)),)


def _line(spots: Spots, rng: np.random.Generator) -> Script:
    return (put("B", BASE, (0.3, float(rng.uniform(-0.4, 0.4)), PART.half_height), any_yaw(rng)),)


def _area(spots: Spots, rng: np.random.Generator) -> Script:
    x, y = rng.uniform([-0.11, -0.045], [0.11, 0.045]).tolist()
    return (put("A", "tray", (x, y, ON_TRAY), any_yaw(rng)),)


def _station(spots: Spots, rng: np.random.Generator) -> Script:
    return put("A", "mat", (0.0, 0.0, 0.03), any_yaw(rng)), put("A", "tray", (0.0, 0.0, ON_TRAY), any_yaw(rng))


def _station_between(spots: Spots, rng: np.random.Generator) -> Script:
    first, last = _station(spots, rng)
    return first, put("C", "tray", (CORNER, 0.0, ON_TRAY), any_yaw(rng)), last


def _two_stations(spots: Spots, rng: np.random.Generator) -> Script:
    first, last = _station(spots, rng)
    return first, put("A", "stamp", (0.0, 0.0, 0.03), any_yaw(rng)), last


def _vise(yaw: Callable[[np.random.Generator], float]) -> Callable[[Spots, np.random.Generator], Script]:
    return lambda spots, rng: (put("B", "vise", (0.0, 0.0, 0.025), yaw(rng)),)


def _tool(spots: Spots, rng: np.random.Generator) -> Script:
    home = spots["tool"]
    return (
        put("A", "tray", (0.0, 0.0, ON_TRAY), any_yaw(rng)),
        put("tool", "A", (0.0, 0.0, 0.045), any_yaw(rng)),
        put("tool", BASE, (home.x, home.y, home.z), home.yaw),
    )


def _screws(spots: Spots, rng: np.random.Generator) -> Script:
    names = rng.permutation([name for name in spots if name.startswith("screw")]).tolist()
    return tuple(drop(name, "bin", (*rng.uniform(-0.06, 0.06, 2).tolist(), 0.09)) for name in names)


def _two_kinds(spots: Spots, rng: np.random.Generator) -> Script:
    names = rng.permutation([name for name in spots if name[:3] in ("scr", "nut")]).tolist()
    into = {"s": "bin", "n": "case"}
    return tuple(drop(n, into[n[0]], (*rng.uniform(-0.04, 0.04, 2).tolist(), 0.09)) for n in names)


def _any_slots(spots: Spots, rng: np.random.Generator) -> Script:
    names = rng.permutation(["A", "B", "C"]).tolist()
    return tuple(put(n, "tray", (x, 0.0, ON_TRAY), any_yaw(rng)) for n, x in zip(names, SLOTS, strict=True))


def _three_of_six(spots: Spots, rng: np.random.Generator) -> Script:
    names = rng.permutation([name for name in spots if name.startswith("screw")]).tolist()[:3]
    return tuple(put(n, "tray", (x, 0.0, 0.025), any_yaw(rng)) for n, x in zip(names, SLOTS, strict=True))


def _by_side(spots: Spots, rng: np.random.Generator) -> Script:
    return (put("A", "tray" if spots["A"].y > 0 else "mat", (0.0, 0.0, 0.03), any_yaw(rng)),)


def _wide_drop(spots: Spots, rng: np.random.Generator) -> Script:
    return (drop("A", "bin", (*np.clip(rng.normal(0, 0.05, 2), -0.08, 0.08).tolist(), 0.09)),)


def _nest(spots: Spots, rng: np.random.Generator) -> Script:
    return (put("A", "nest", (0.0, 0.0, 0.035), 0.0),)


def _plates(spots: Spots, rng: np.random.Generator) -> Script:
    up = (0.0, 0.0, 0.008)
    return put("P", "tray", (0.0, 0.0, 0.014), 0.0), put("Q", "P", up, 0.0), put("R", "Q", up, 0.0)


def _lid(spots: Spots, rng: np.random.Generator) -> Script:
    return (
        somewhere("lid", LID, spots, rng),
        put("A", "crate", (0.0, 0.0, IN_CRATE), 0.0),
        put("lid", "crate", (0.0, 0.0, 0.05), 0.0),
    )


def _pallet(spots: Spots, rng: np.random.Generator) -> Script:
    low, high = 0.01 + BAR.half_height, 0.01 + 3 * BAR.half_height
    below = tuple(put(n, "tray", (0.0, y, low), 0.0) for n, y in (("P", -0.03), ("Q", 0.03)))
    return *below, put("R", "tray", (0.0, 0.0, high), math.pi / 2)


def _exchange(spots: Spots, rng: np.random.Generator) -> Script:
    a, b = spots["A"], spots["C"]
    return (
        somewhere("A", CUBE, spots, rng),
        put("C", BASE, (a.x, a.y, a.z), any_yaw(rng)),
        put("A", BASE, (b.x, b.y, b.z), any_yaw(rng)),
    )


def _turn_here(spots: Spots, rng: np.random.Generator) -> Script:
    here = spots["B"]
    return (put("B", BASE, (here.x, here.y, here.z), here.yaw + math.pi / 2),)


def _from_nest(spots: Spots, rng: np.random.Generator) -> Script:
    name = min(("A", "C", "D"), key=lambda each: math.dist((spots[each].x, spots[each].y), _xy(spots["mat"])))
    return (put(name, "tray", (0.0, 0.0, ON_TRAY), any_yaw(rng)),)


def _from_the_front(spots: Spots, rng: np.random.Generator) -> Script:
    name = min(("A", "C", "D"), key=lambda each: spots[each].x)
    return (put(name, "tray", (0.0, 0.0, ON_TRAY), any_yaw(rng)),)


def _xy(spot: Spot) -> tuple[float, float]:
    return spot.x, spot.y


def _fixed_corner(spots: Spots, rng: np.random.Generator) -> Script:
    return (put("B", BASE, (0.6, 0.3, PART.half_height), 0.8),)


def _follow(spots: Spots, rng: np.random.Generator) -> Script:
    return put("A", "tray", (0.0, 0.0, ON_TRAY), 0.0), put("C", "A", (0.0, 0.0, 0.05), 0.0)


def _row(spots: Spots, rng: np.random.Generator) -> Script:
    return tuple(put(n, "tray", (x, 0.0, ON_TRAY), 0.0) for n, x in zip("ACD", SLOTS, strict=True))


def _out_of_bin(spots: Spots, rng: np.random.Generator) -> Script:
    return (put("A", "tray", (0.0, 0.0, ON_TRAY), any_yaw(rng)),)


def _clear_the_mat(spots: Spots, rng: np.random.Generator) -> Script:
    return (somewhere("A", CUBE, spots, rng),)


def _measure(spots: Spots, rng: np.random.Generator) -> Script:
    """Put on the scale, and back where it came from."""
    home = spots["A"]
    return put("A", "mat", (0.0, 0.0, 0.03), any_yaw(rng)), put("A", BASE, (home.x, home.y, home.z), home.yaw)


def _equal(course: Course, names: Sequence[str], slots: Sequence[Vector], frame: str) -> bool:
    """Whether each slot has one of some equal objects."""
    taken = [[name for name in names if course.at(name, frame, at)] for at in slots]
    return all(taken) and len({name for found in taken for name in found[:1]}) == len(slots)


def _tray_slots(height: float) -> list[Vector]:
    return [(x, 0.0, height) for x in SLOTS]


def _on_tray(course: Course, name: str = "A") -> bool:
    return course.at(name, "tray", (0.0, 0.0, ON_TRAY))


def _is_upon_tray(course: Course) -> bool:
    here = course.spots["tray"].relative(course.spots["A"])
    return abs(here.x) < 0.13 and abs(here.y) < 0.06 and abs(here.z - ON_TRAY) < 0.012


def _among(course: Course, name: str, one: str, other: str) -> bool:
    x, y = _middle(course.spots, one, other)
    return math.dist(_xy(course.spots[name]), (x, y)) < 0.04


def _screw_names(spots: Spots) -> list[str]:
    return [name for name in spots if name.startswith("screw")]


def _listed(*tasks: ShopTask) -> dict[str, ShopTask]:
    return {task.name: task for task in tasks}


UPON_MAT, UPON_STAMP = (0.0, 0.0, 0.03), (0.0, 0.0, 0.03)
SHOP = _listed(
    ShopTask("between", "a frame of two objects", {"A": CUBE, "B": PART, "C": CUBE}, _between,
             lambda c: _among(c, "B", "A", "C")),
    ShopTask("beside", "the base's axes", {"A": CUBE, "B": PART}, _beside,
             lambda c: math.dist(_xy(c.spots["B"]), (c.spots["A"].x + 0.13, c.spots["A"].y)) < 0.04),
    ShopTask("line", "a line", {"A": CUBE, "B": PART}, _line, lambda c: abs(c.spots["B"].x - 0.3) < 0.03),
    ShopTask("area", "an area", {"A": CUBE, "tray": TRAY}, _area,
             _is_upon_tray),
    ShopTask("station", "a visit", {"A": CUBE, "mat": MAT, "tray": TRAY}, _station,
             lambda c: c.visited("A", "mat", UPON_MAT) and _on_tray(c)),
    ShopTask("station_between", "a visit", {"A": CUBE, "C": CUBE, "mat": MAT, "tray": TRAY}, _station_between,
             lambda c: c.visited("A", "mat", UPON_MAT) and _on_tray(c)
             and c.at("C", "tray", (CORNER, 0.0, ON_TRAY))),
    ShopTask("two_stations", "two visits in order", {"A": CUBE, "mat": MAT, "stamp": MAT, "tray": TRAY}, _two_stations,
             lambda c: c.visited("A", "mat", UPON_MAT) and c.visited("A", "stamp", UPON_STAMP) and _on_tray(c)),
    ShopTask("vise_one_way", "an orientation", {"B": PART, "vise": VISE}, _vise(lambda rng: 0.0),
             lambda c: c.at("B", "vise", (0.0, 0.0, 0.025), 0.012) and c.turned("B", "vise", 0.0)),
    ShopTask("vise_any_way", "", {"B": PART, "vise": VISE}, _vise(lambda rng: math.pi * float(rng.integers(2))),
             lambda c: c.at("B", "vise", (0.0, 0.0, 0.025), 0.012)),
    ShopTask("tool_back", "a place of the start", {"A": CUBE, "tool": PART, "tray": TRAY}, _tool,
             lambda c: _on_tray(c) and c.visited("tool", "A", (0.0, 0.0, 0.045))
             and math.dist(_xy(c.spots["tool"]), _xy(c.start["tool"])) < 0.04),
    ShopTask("screws", "a kind", {**{f"screw{n}": SCREW for n in range(1, 4)}, "bin": BIN}, _screws,
             lambda c: all(c.within(name, "bin") for name in _screw_names(c.spots)), strangers={"screw9": SCREW}),
    ShopTask("screws_and_nuts", "two kinds", {"screw1": SCREW, "screw2": SCREW, "nut1": NUT, "nut2": NUT, "bin": BIN,
                                              "case": CASE}, _two_kinds,
             lambda c: all(c.within(n, "bin" if n[0] == "s" else "case") for n in c.spots if n[:3] in ("scr", "nut")),
             strangers={"nut7": NUT}),
    ShopTask("any_slots", "equal parts", {"A": CUBE, "B": CUBE, "C": CUBE, "tray": TRAY}, _any_slots,
             lambda c: _equal(c, "ABC", _tray_slots(ON_TRAY), "tray")),
    ShopTask("three_of_six", "a count of a kind", {**{f"screw{n}": SCREW for n in range(1, 7)}, "tray": TRAY},
             _three_of_six, lambda c: _equal(c, _screw_names(c.spots), _tray_slots(0.025), "tray")),
    ShopTask("by_side", "a goal by the start", {"A": CUBE, "tray": TRAY, "mat": MAT}, _by_side,
             lambda c: c.at("A", "tray" if c.start["A"].y > 0 else "mat", (0.0, 0.0, 0.03))),
    ShopTask("wide_drop", "", {"A": CUBE, "bin": BIN}, _wide_drop, lambda c: c.within("A", "bin")),
    ShopTask("nest", "a pocket", {"A": CUBE, "nest": NEST}, _nest,
             lambda c: c.at("A", "nest", (0.0, 0.0, 0.035), 0.015)),
    ShopTask("plates_fine", "an order of thin layers", {"P": PLATE, "Q": PLATE, "R": PLATE, "tray": TRAY}, _plates,
             lambda c: c.spots["P"].z < c.spots["Q"].z < c.spots["R"].z
             and all(c.at(n, "tray", (0.0, 0.0, 0.022), 0.03) for n in "PQR"), accuracy_m=0.0005),
    ShopTask("plates", "an order of thin layers", {"P": PLATE, "Q": PLATE, "R": PLATE, "tray": TRAY}, _plates,
             lambda c: c.spots["P"].z < c.spots["Q"].z < c.spots["R"].z
             and all(c.at(n, "tray", (0.0, 0.0, 0.022), 0.03) for n in "PQR")),
    ShopTask("lid", "what is put aside and back", {"A": CUBE, "crate": CRATE, "lid": LID}, _lid,
             lambda c: c.at("A", "crate", (0.0, 0.0, IN_CRATE)) and c.at("lid", "crate", (0.0, 0.0, 0.05)),
             upon=(("lid", "crate"),)),
    ShopTask("pallet", "an orientation", {"P": BAR, "Q": BAR, "R": BAR, "tray": TRAY}, _pallet,
             lambda c: c.at("R", "tray", (0.0, 0.0, 0.07)) and c.turned("R", "tray", math.pi / 2, math.pi)
             and all(c.turned(n, "tray", 0.0, math.pi) for n in "PQ")),
    ShopTask("exchange", "places of the start", {"A": CUBE, "C": CUBE}, _exchange,
             lambda c: math.dist(_xy(c.spots["A"]), _xy(c.start["C"])) < 0.04
             and math.dist(_xy(c.spots["C"]), _xy(c.start["A"])) < 0.04),
    ShopTask("turn_here", "an orientation of the start", {"B": PART}, _turn_here,
             lambda c: c.turned("B", BASE, c.start["B"].yaw + math.pi / 2)),
    ShopTask("nearest_to_mat", "an object by its place", {"A": CUBE, "C": CUBE, "D": CUBE, "mat": MAT, "tray": TRAY},
             _from_nest, lambda c: any(_on_tray(c, n) and math.dist(_xy(c.start[n]), _xy(c.start["mat"])) <= min(
                 math.dist(_xy(c.start[o]), _xy(c.start["mat"])) for o in "ACD") for n in "ACD")),
    ShopTask("from_the_front", "an object by its place", {"A": CUBE, "C": CUBE, "D": CUBE, "tray": TRAY},
             _from_the_front, lambda c: any(_on_tray(c, n) and c.start[n].x <= min(c.start[o].x for o in "ACD")
                                            for n in "ACD")),
    ShopTask("corner", "an orientation of the base", {"A": CUBE, "B": PART}, _fixed_corner,
             lambda c: c.at("B", BASE, (0.6, 0.3, PART.half_height)) and c.turned("B", BASE, 0.8)),
    ShopTask("tower_on_tray", "", {"A": CUBE, "C": CUBE, "tray": TRAY}, _follow,
             lambda c: _on_tray(c) and c.at("C", "A", (0.0, 0.0, 0.05))),
    ShopTask("row", "", {"A": CUBE, "C": CUBE, "D": CUBE, "tray": TRAY}, _row,
             lambda c: all(c.at(n, "tray", at) for n, at in zip("ACD", _tray_slots(ON_TRAY), strict=True))),
    ShopTask("out_of_bin", "", {"A": CUBE, "bin": BIN, "tray": TRAY}, _out_of_bin, _on_tray, upon=(("A", "bin"),)),
    ShopTask("clear_the_mat", "anywhere but here", {"A": CUBE, "mat": MAT}, _clear_the_mat,
             lambda c: math.dist(_xy(c.spots["A"]), _xy(c.spots["mat"])) > 0.1, upon=(("A", "mat"),)),
    ShopTask("measure", "a goal that holds at the start", {"A": CUBE, "mat": MAT}, _measure,
             lambda c: c.visited("A", "mat", UPON_MAT)
             and math.dist(_xy(c.spots["A"]), _xy(c.start["A"])) < 0.04),
)  # fmt: skip
"""By name."""


def start_of(task: ShopTask, rng: np.random.Generator, strangers: bool = False) -> dict[str, Spot]:
    """A random start of a task, nothing touching anything that it does not stand on."""
    bodies = {**task.objects, **(task.strangers if strangers else {})}
    upper = dict(task.upon)
    while True:
        spots: dict[str, Spot] = {}
        for name in sorted(set(bodies) - set(upper), key=lambda name: -bodies[name].radius):
            _lay_anywhere(name, bodies, spots, rng)
        if len(spots) + len(upper) == len(bodies):
            break
    table = Table(bodies, spots, rng)
    for name, below in task.upon:
        table.spots[name] = replace(table.spots[below], yaw=table.spots[below].yaw)
        table.lay(name, table.spots[below])
    return dict(table.spots)


def _lay_anywhere(name: str, bodies: Mapping[str, Body], spots: dict[str, Spot], rng: np.random.Generator) -> None:
    """Put an object somewhere free, if that is found soon."""
    edge = bodies[name].radius
    for _ in range(50):
        x, y = rng.uniform([0.15 + edge, -0.5 + edge], [0.85 - edge, 0.5 - edge]).tolist()
        if all(math.dist((x, y), _xy(o)) > edge + bodies[other].radius + 0.02 for other, o in spots.items()):
            spots[name] = Spot(x, y, bodies[name].half_height, any_yaw(rng))
            return


def is_possible(task: ShopTask, start: Spots, script: Script) -> bool:
    """Whether each place of a script is on the table and free but for what it is to stand on."""
    table = Table(task.objects, start, np.random.default_rng(0))
    moved = {move.object for move in script}
    for move in script:
        there = table.spots.get(move.frame, ORIGIN).compose(Spot(*move.at, move.yaw or 0.0))
        hull = table.footprint(move.object, there)
        beside = (b for b in table.obstacles({move.object, move.frame}) if b.top > hull.bottom + 0.003)
        near = any(block.overlaps(hull, 0.0 if block.name in moved else -ROOM_M) for block in beside)
        if near or not (0.12 < there.x < 0.88 and abs(there.y) < 0.52):
            return False
        if move.type == "drop":
            there = replace(there, z=table.support_m(move.object, there) + task.objects[move.object].half_height)
        table.spots[move.object] = there
    return True


ORIGIN = Spot(0.0, 0.0, 0.0, 0.0)
ROOM_M = 0.03
"""What a script does not move keeps this distance from its places."""
