"""The stage: what was demonstrated, set up in simulation, and trees put into the simulated hand's terms.

Simulated bodies stand upright on a table at z = 0 and are grasped by a hand whose frame is the point between the
fingertips, z along the approach, x along a face of what it holds. Real cells have tables at other heights, markers on
any face, and name another point of the gripper their end-effector. All of that is read off the demonstrations.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, TypeVar

import numpy as np

from learner.model import DemonstratedAction, Demonstration, Node, ObjectShape, Pose, Scene
from learner.model.frame import is_composed, objects_of
from learner.model.pose import Array, Quaternion, Vector, conjugate, multiply, rotate
from learner.model.poses import Poses
from learner.model.query import Site, sites_of, written_sites
from learner.model.tree import Value, is_reference
from learner.model.upright import Spot
from learner.planning.actions import scene_of
from learner.rehearsal.landing import Landing, sentence_on, unlike
from learner.rehearsal.parameters import RehearsalParameters
from learner.relations.grasping import Grasp
from learner.relations.knowledge import UNKNOWING, Knowledge
from learner.simulation.gravity import WALL_M, Body, Table
from learner.simulation.kinematic_world import NOISELESS, REACH_M, WORKSPACE_M, KinematicWorld, Noise

POINT: Final = ObjectShape((0.02, 0.02, 0.02), "vertical")
"""What stands for an object whose shape nobody told; it meets nothing."""

Spots = Mapping[str, Spot]
Item = TypeVar("Item")


def spread_evenly(items: Sequence[Item], most: int) -> list[Item]:
    """At most so many of the items, evenly spread over all of them, the first and the last among them."""
    places = np.linspace(0, len(items) - 1, min(len(items), most)).round().astype(int)
    return [items[place] for place in places]


class Points(Table):
    """Bodies without extent: nothing falls, stands on anything or is met (CONTRACT, section 2: without scene)."""

    def support_m(self, name: str, spot: Spot, below_m: float = math.inf) -> float:
        """Whatever its height, it stays there."""
        return spot.z - self.bodies[name].half_height

    def on(self, name: str) -> set[str]:
        """Nothing."""
        return set()

    def obstacles(self, without: object) -> list[object]:  # type: ignore[override]  # always empty
        """Nothing."""
        return []

    def lay(self, name: str, spot: Spot) -> None:
        """Put a body where it is put, at the height that it has."""
        self.spots[name] = replace(spot, z=self.spots[name].z)

    def drop(self, name: str, spot: Spot) -> float:
        """Stays."""
        self.spots[name] = spot
        return 0.0


@dataclass(frozen=True)
class Start:
    """Where everything stood when a demonstration began, in the stage's terms."""

    demonstration_id: str
    spots: Spots


class Stage:
    """The stage of demonstrations of one task.

    `bodies`: an object within which something lay or came to rest is an open box, any other a block; what was picked
    can be grasped, and so can its like and what is small. `starts`: of the demonstrations whose releases the stage
    reproduces; `left_out` gives the reason for each other one. `unlike` tells, by object and what it lies on, how far
    from where all demonstrations left it something comes to rest: there the stage lacks something (a pocket, a rim).
    Without a scene objects are points. `turns` take an object's frame to that of its upright body, `origins_m` is how
    high its origin lies in that, whose own is in the middle.
    """

    def __init__(self, demonstrations: Sequence[Demonstration], parameters: RehearsalParameters | None = None) -> None:
        self.demonstrations, self.parameters = demonstrations, parameters or RehearsalParameters()
        self.numbers = self.parameters.stage
        self.base = demonstrations[0].base_frame
        self.scene = scene_of(demonstrations)
        self.begins = [demonstration.first_seen for demonstration in demonstrations]
        self.names = sorted({name for begin in self.begins for name in begin})
        self.turns = {name: _turned_up(self._up(name)) for name in self.names}
        self.shapes = {name: self._standing(name) for name in self.names}
        self.table_m = self._table_m()
        self.origins_m = {name: self._origin_m(name) for name in self.names}
        self.bodies = {name: self._body(name) for name in self.names}
        self.shift = self._shift()
        self.tip = self._tip()
        some = spread_evenly(demonstrations, self.numbers.most_starts)
        self._landed = {shown.demonstration_id: self._landings(shown) for shown in some}
        self.unlike = unlike((one for landings in self._landed.values() for one in landings), self.numbers.agreed_m)
        reasons = {shown.demonstration_id: self._why_not(shown) for shown in some}
        self.left_out = {name: reason for name, reason in reasons.items() if reason}
        self.starts = [self._start(shown) for shown in some if shown.demonstration_id not in self.left_out]

    @cached_property
    def points(self) -> bool:
        """Whether objects are points, because the shape of one that was seen is not known."""
        known = self.scene.objects if self.scene else {}
        return not set(self.names) <= set(known)

    def world(
        self, spots: Spots, rng: np.random.Generator, noise: Noise | None = None, knowledge: Knowledge = UNKNOWING
    ) -> KinematicWorld:
        """A kinematic world in which everything stands at `spots`, with what a tree knows in the stage's terms, seen
        with the noise of the cell or another one.
        """
        world = KinematicWorld(
            self.bodies, spots, rng, noise or self.noise, self.base, workspace_m=self.workspace_m,
            sizes=self.sizes, end_effector=self.end_effector, knowledge=knowledge,
        )  # fmt: skip
        if self.points:
            world.table = Points(self.bodies, spots, rng)
        return world

    @property
    def noise(self) -> Noise:
        """What the cell's camera scatters, as its scene tells; else the usual."""
        usual, scene = Noise(), self.scene or Scene({})
        return Noise(scene.accuracy_m or usual.position_m, scene.accuracy_rad or usual.angle_rad)

    @property
    def sizes(self) -> dict[str, Vector]:
        """By which the robot knows what it holds: the upright bodies' [m], none where objects are points."""
        return {} if self.points else {name: shape.size_m for name, shape in self.shapes.items()}

    @property
    def end_effector(self) -> Vector:
        """The demonstrations' end-effector frame in the simulated hand's [m]."""
        return self.tip.inverse().position

    @property
    def workspace_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The simulated cell's, widened to all that was seen: the arm reached it, or a person did."""
        (x0, y0), (x1, y1) = (self._seen_m + np.array(self.shift[:2])).tolist()
        (a0, a1), (b0, b1) = WORKSPACE_M
        return (min(a0, x0), max(a1, x1)), (min(b0, y0), max(b1, y1))

    def moved(self, x: float, y: float) -> Stage:
        """The same stage with everything shifted over the table [m]."""
        other = copy.copy(self)
        other.shift = (self.shift[0] + x, self.shift[1] + y, self.shift[2])
        other.starts = [replace(start, spots={n: replace(s, x=s.x + x, y=s.y + y) for n, s in start.spots.items()})
                        for start in self.starts]  # fmt: skip
        return other

    # -- terms -------------------------------------------------------------------------------------------------------

    def root(self, root: Node) -> Node:
        """A flattened tree in the stage's terms: poses of the simulated hand, frames of upright bodies."""
        known = {ports: self._ports(dict(ports)) for ports in {node.ports for node in root.walk()}}

        def moved(node: Node) -> Node:
            ports = known[node.ports] if node.kind != "ObjectPosedAt" else self._posed(dict(node.ports))
            return replace(node, ports=ports, children=tuple(moved(child) for child in node.children))

        return moved(root)

    def _ports(self, ports: dict[str, Value]) -> tuple[tuple[str, Value], ...]:
        frame = str(ports.get("frame", ""))
        for name in {"at", "not_at"} & ports.keys():
            ports[name] = written_sites(tuple(map(self.site, sites_of(str(ports[name])))))
        if is_reference(ports.get("position", "")):
            return tuple(sorted(ports.items()))
        if "orientation" in ports:
            pose = self._into(frame) @ Pose(ports["position"], ports["orientation"]) @ self.tip  # type: ignore[arg-type]  # checked by Tree
            ports |= {"position": pose.position, "orientation": pose.quaternion_xyzw}
        elif "position" in ports:
            ports["position"] = self.point(frame, ports["position"])  # type: ignore[arg-type]  # checked by Tree
        return tuple(sorted(ports.items()))

    def _posed(self, ports: dict[str, Value]) -> tuple[tuple[str, Value], ...]:
        orientation = self.turned(str(ports["frame"]), str(ports["object"]), ports["orientation"])  # type: ignore[arg-type]  # checked by Tree
        position = self.point(str(ports["frame"]), ports["position"])  # type: ignore[arg-type]  # as above
        return tuple(sorted({**ports, "position": position, "orientation": orientation}.items()))

    def turned(self, frame: str, name: str, quaternion_xyzw: Quaternion) -> Quaternion:
        """The orientation of an upright body in the stage's frame, for that of its object in the one demonstrated."""
        into, own = self._into(frame), Pose((0.0, 0.0, 0.0), self.turns[name])
        return (into @ Pose((0.0, 0.0, 0.0), quaternion_xyzw) @ own.inverse()).quaternion_xyzw

    def point(self, frame: str, position: Vector) -> Vector:
        """A point [m] of a frame as it was demonstrated, in the stage's frame of that name."""
        return self._into(frame).apply(position)

    def site(self, site: Site) -> Site:
        """A place of the demonstrations, on the stage."""
        return replace(site, position=self.point(site.frame, site.position))

    def knowledge(self, root: Node, grasps: Sequence[Grasp]) -> Knowledge:
        """What a tree in the stage's terms is answered by."""
        return Knowledge.of(root, map(self._grasp, grasps))

    def _grasp(self, grasp: Grasp) -> Grasp:
        """A grasp as the simulated hand does it; one of a kind or size goes by an object of it."""
        shapes = self.scene.objects if self.scene else {}
        alike = (name for name in self.turns if name in shapes and grasp.fits(shapes[name]))
        name = next(alike, None) if grasp.object is None else grasp.object
        if name not in self.turns:
            return grasp
        return replace(grasp, pose=self._into(name) @ grasp.pose @ self.tip)

    def spot(self, name: str, pose_in_base: Pose) -> Spot:
        """Where a body stands whose object has a pose in the demonstrations' base."""
        position = np.add(pose_in_base.position, self.shift) - np.array([0.0, 0.0, self.origins_m[name]])
        quaternion = multiply(np.array(pose_in_base.quaternion_xyzw), conjugate(np.array(self.turns[name])))
        return Spot.of(Pose.of(position, quaternion))

    def _into(self, frame: str) -> Pose:
        if frame == self.base:
            return Pose(self.shift)
        if is_composed(frame):  # upright, whatever the objects that it goes by are turned to
            return Pose((0.0, 0.0, float(np.mean([self.origins_m[name] for name in objects_of(frame)]))))
        return Pose((0.0, 0.0, self.origins_m[frame]), self.turns[frame])

    # -- what was seen -----------------------------------------------------------------------------------------------

    def _poses(self, name: str) -> list[Pose]:
        return [begin[name] for begin in self.begins if name in begin]

    def _seen(self) -> Iterator[Pose]:
        for begin, demonstration in zip(self.begins, self.demonstrations, strict=True):
            yield from begin.values()
            yield from (action.end_effector for action in demonstration.actions)

    def _up(self, name: str) -> Array:
        """The direction (3,), in the object's frame, that points up when it stands as it mostly does."""
        ups = _ups(self._poses(name))
        agreeing = ups @ ups.T > math.cos(self.numbers.upright_rad)
        mean = ups[agreeing[int(np.argmax(agreeing.sum(axis=1)))]].mean(axis=0)
        return np.asarray(mean / np.linalg.norm(mean))

    def _standing(self, name: str) -> ObjectShape:
        """The shape along the axes of the upright body."""
        if self.points:
            return POINT
        assert self.scene is not None
        shape, axis = self.scene.objects[name], _main_axis(self._up(name))
        x, y, z = np.abs(rotate(np.array(_upright(axis)), np.array(shape.size_m))).tolist()
        round_ = shape.symmetry != "vertical" or axis[2] != 0
        return replace(shape, size_m=(x, y, z), symmetry=shape.symmetry if round_ else "none")

    def _table_m(self) -> float:
        """The table's height [m] in the base: of what is picked, the lowest stands on it."""
        bottoms = [
            min(pose.position[2] - self.shapes[name].size_m[2] / 2 for name, pose in begin.items() if name in some)
            for begin in self.begins
            if (some := self._picked & set(begin))
        ]
        return float(np.median(bottoms)) - (self.numbers.floating_m if self.points else 0.0)

    def _origin_m(self, name: str) -> float:
        """How high the origin is above the body's middle [m]: 0, unless it would then stand deep in the table."""
        if self.points or name in self._picked:
            return 0.0
        lowest = float(np.median([pose.position[2] for pose in self._poses(name)])) - self.table_m
        half = self.shapes[name].size_m[2] / 2
        return lowest - half if -self.numbers.origin_m <= lowest < half - self.numbers.origin_m else 0.0

    def _body(self, name: str) -> Body:
        shape = self.shapes[name]
        if not self.points and (shape.open or self._contains(name)):
            return Body(shape, "open_box")
        graspable = any(sorted(self.shapes[other].size_m) == sorted(shape.size_m) for other in self._picked)
        return Body(shape, stroke_m=max(Body.stroke_m, min(shape.size_m[:2]))) if graspable else Body(shape)

    @cached_property
    def _picked(self) -> set[str]:
        return {action.object for d in self.demonstrations for action in d.actions if action.type == "pick"}

    def _contains(self, name: str) -> bool:
        """Whether something lay or came to rest within the shape of an object that nobody picked."""
        half_x, half_y, half_z = (size / 2 for size in self.shapes[name].size_m)
        for inner, pose in self._rests_in(name):
            x, y, z = self._into(name).apply(pose.position)
            width, depth, height = self.shapes[inner].size_m
            fits = min(half_x, half_y) > min(width, depth) / 2 + WALL_M
            if (
                fits
                and abs(x) < half_x
                and abs(y) < half_y
                and -half_z < z < half_z - self.numbers.inside_m + height / 2
            ):
                return True
        return False

    def _rests_in(self, name: str) -> Iterator[tuple[str, Pose]]:
        """What lay or came to rest in the frame of an object that nobody picked, and where."""
        for begin, demonstration in zip(self.begins, self.demonstrations, strict=True):
            if name not in self._picked:
                for world in (begin, demonstration.final):
                    others = [other for other in self.names if other != name and other in world and name in world]
                    yield from ((other, world[name].inverse() @ world[other]) for other in others)
                rests = ((action.object, action.rest) for action in demonstration.actions if action.rest is not None)
                yield from ((other, rest[name]) for other, rest in rests if name in rest)

    @cached_property
    def _seen_m(self) -> Array:
        """The least and the greatest x and y (2, 2) [m] of all that was seen, in the demonstrations' base."""
        seen = np.array([pose.position[:2] for pose in self._seen()])
        return np.array([seen.min(axis=0), seen.max(axis=0)])

    def _shift(self) -> Vector:
        """From the demonstrations' base to the stage's [m]: the table down to 0, the middle into the workspace."""
        low, high = self._seen_m
        room = np.array(WORKSPACE_M)
        fits = (low >= room[:, 0] - REACH_M).all() and (high <= room[:, 1] + REACH_M).all()
        x, y = (0.0, 0.0) if fits else (room.mean(axis=1) - (low + high) / 2).tolist()
        return (x, y, -self.table_m)

    # -- the hand ----------------------------------------------------------------------------------------------------

    def _tip(self) -> Pose:
        """The point between the fingertips in the end-effector's frame: where the objects are when they are grasped."""
        picks = [action for d in self.demonstrations for action in d.actions if action.type == "pick"]
        hands = Poses.of([pick.end_effector for pick in picks])
        objects = Poses.of([pick.objects[pick.object] for pick in picks])
        held = (hands.inverse() @ objects).positions
        down = -rotate(conjugate(hands.quaternions_xyzw), np.array([0.0, 0.0, 1.0])).mean(axis=0)
        z = down / np.linalg.norm(down)
        x = np.cross(np.cross(z, _most_across(z)), z)
        x /= np.linalg.norm(x)
        angle = self._face([pick.object for pick in picks], hands, objects, x, np.cross(z, x))
        x = math.cos(angle) * x + math.sin(angle) * np.cross(z, x)
        return Pose.of(np.median(held, axis=0), _quaternion(np.column_stack([x, np.cross(z, x), z])))

    def _face(self, names: Sequence[str], hands: Poses, objects: Poses, x: Array, y: Array) -> float:
        """The turn [rad] from x to the nearest face of what is grasped, modulo quarter turns; 0 if they tell none."""
        told = np.array([self.bodies[name].shape.symmetry != "vertical" for name in names], dtype=np.bool_)
        turns = np.array([self.turns[name] for name in names])[told]
        bodies = multiply(objects[told].quaternions_xyzw, conjugate(turns))
        sides = rotate(bodies, np.array([1.0, 0.0, 0.0]))
        sides = rotate(conjugate(hands[told].quaternions_xyzw), sides)
        mean = np.exp(4j * np.arctan2((sides * y).sum(axis=1), (sides * x).sum(axis=1))).mean() if told.any() else 0.0
        return float(np.angle(mean)) / 4 if abs(mean) > self.numbers.least_turn else 0.0

    # -- starts ------------------------------------------------------------------------------------------------------

    def start(self, demonstration: Demonstration) -> Start | None:
        """Where a demonstration began; None if the stage does not reproduce it."""
        return None if self._why_not(demonstration) else self._start(demonstration)

    def _why_not(self, demonstration: Demonstration) -> str | None:
        """Why the stage does not reproduce a demonstration, None if it does."""
        landings = self._landed.get(demonstration.demonstration_id) or self._landings(demonstration)
        different = (reason for one in landings if (reason := self._differs(one)))
        return self._tilted(demonstration.first_seen) or next(different, None)

    def _start(self, demonstration: Demonstration) -> Start:
        begin = demonstration.first_seen
        spots = self._spots(begin)
        table = self.world(spots, np.random.default_rng(0), NOISELESS).table
        table.settle(name for name in spots if name in begin)
        return Start(demonstration.demonstration_id, dict(table.spots))

    def _spots(self, poses: Mapping[str, Pose]) -> dict[str, Spot]:
        """Where everything stands; what nobody saw stands far away."""
        absent = {
            name: Spot(self.numbers.absent_m + number, self.numbers.absent_m, self.bodies[name].half_height, 0.0)
            for number, name in enumerate(self.names)
            if name not in poses
        }
        return absent | {name: self.spot(name, pose) for name, pose in poses.items() if name in self.turns}

    def _tilted(self, poses: Mapping[str, Pose]) -> str | None:
        for name, pose in poses.items():
            up = rotate(np.array(self.turns[name]), _ups([pose])[0])
            if up[2] < math.cos(self.numbers.upright_rad):
                return f"{name} lies on another face than in the others"
        return None

    def _landings(self, demonstration: Demonstration) -> list[Landing]:
        """Each release of a demonstration, done on the stage."""
        return [self._landing(action) for action in demonstration.actions if action.rest is not None]

    def _landing(self, action: DemonstratedAction) -> Landing:
        assert action.rest is not None
        name = action.object
        poses = {other: pose for other, pose in action.objects.items() if other in self.turns}
        world = self.world(self._spots(poses), np.random.default_rng(0), NOISELESS)
        world.held = name
        met = world.met_by_held() if not self.points and action.type == "place" else None
        above = world.table.spots[name]
        world.table.drop(name, above)
        rest, shown = world.table.spots[name], self.spot(name, action.rest[self.base])
        dropped = action.type == "drop" or above.z - shown.z > self.numbers.fell_m
        off = (0.0, 0.0, 0.0) if self.points else (rest.x - shown.x, rest.y - shown.y, rest.z - shown.z)
        return Landing(name, self._under(action), dropped, off, met)

    def _under(self, action: DemonstratedAction) -> str | None:
        """The object within whose outline the one released came to rest, the nearest if several; None for none."""
        rests = {name: self._into(name).apply(pose.position) for name, pose in (action.rest or {}).items()
                 if name in self.shapes}  # fmt: skip
        within = [
            (math.hypot(x, y), name)
            for name, (x, y, _) in rests.items()
            if abs(x) <= self.shapes[name].size_m[0] / 2 and abs(y) <= self.shapes[name].size_m[1] / 2
        ]
        return min(within)[1] if within else None

    def _differs(self, landing: Landing) -> str | None:
        """What the stage does otherwise at a release, None if it does as was shown."""
        if landing.met:
            return f"where {landing.object} was let go it would meet {landing.met}"
        if (landing.object, landing.under) in self.unlike and not landing.dropped:
            return sentence_on(landing, self.unlike[landing.object, landing.under])
        near_m = self.numbers.dropped_m if landing.dropped else self.numbers.placed_m
        return f"{landing.object} would not stay where it came to rest" if landing.away_m > near_m else None


def _ups(poses: Sequence[Pose]) -> Array:
    """The base's vertical (n, 3) in each pose's frame."""
    return rotate(conjugate(np.array([pose.quaternion_xyzw for pose in poses])), np.array([0.0, 0.0, 1.0]))


def _main_axis(up: Array) -> Array:
    """Of the directions ±x, ±y, ±z the one (3,) nearest to `up`."""
    axis = np.zeros(3)
    strongest = int(np.argmax(np.abs(up)))
    axis[strongest] = math.copysign(1.0, up[strongest])
    return axis


def _turned_up(up: Array) -> Quaternion:
    """A turn that takes `up` (3,) to the vertical and faces to faces: quarter turns, then the least that is left."""
    quarters = np.array(_upright(_main_axis(up)))
    x, y, z, w = multiply(np.array(_upright(rotate(quarters, up))), quarters).tolist()
    return (x, y, z, w)


def _upright(up: Array) -> Quaternion:
    """The least turn that takes a direction (3,) of an object's frame to the vertical."""
    x, y, z = up.tolist()
    if z < -1 + 1e-9:
        return (1.0, 0.0, 0.0, 0.0)
    norm = math.sqrt(x * x + y * y + (1 + z) ** 2)
    return (y / norm, -x / norm, 0.0, (1 + z) / norm)


def _most_across(z: Array) -> Array:
    """The end-effector's own axis (3,) that lies across the approach; x, unless the hand points along it."""
    return np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.7 else np.array([0.0, 1.0, 0.0])


def _quaternion(matrix: Array) -> Quaternion:
    """The unit quaternion xyzw of a rotation matrix (3, 3)."""
    m = matrix
    values = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0.0, 0.0, 0.0],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0.0, 0.0],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0.0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]],
        ]
    )
    x, y, z, w = np.linalg.eigh(values / 3.0)[1][:, -1].tolist()
    return (x, y, z, w)
