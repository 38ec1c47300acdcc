"""Recovery from what was not demonstrated: what covers an object or occupies its place is put aside first.

All of it stands in SubTrees whose ID begins with `Recover_`. With a scene every object that can be grasped may cover
or occupy; without one, objects are points and only the stackings that were demonstrated are known. Fallbacks over an
action have memory, so that lifting an object off does not end the action that lifts it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from learner.inference.goals import Subgoal
from learner.inference.targets import Target
from learner.model import Condition, Definition, Demonstration, InGripper, Node, ObjectAt, Pick, Place, Pose, SetGripper
from learner.model.condition import DROP_RADIUS_M, PLACE_RADIUS_M, GripperIs, ObjectRoughlyAt
from learner.model.names import distinct_identifiers
from learner.model.pose import Array, conjugate, cross, rotate
from learner.model.tree import RECOVERY_PREFIX, Value, fallback, leaf, sequence, subtree
from learner.planning.actions import LearnedActions
from learner.planning.grasps import Upright, borrowed_grasp, quarter_turned
from learner.planning.rounding import rounded, rounded_pose, rounded_vector

PUT_DOWN = f"{RECOVERY_PREFIX}PutDown"
SPOT_FREE = f"{RECOVERY_PREFIX}SpotIsFree"


@dataclass(frozen=True)
class Cover:
    """`object` lies upon `under` when its origin is within `radius` [m] of `position` [m] in the frame of `under`."""

    object: str
    under: str
    position: tuple[float, float, float]
    radius: float
    direct: bool = True
    """Whether nothing lies between."""

    @property
    def condition(self) -> ObjectAt:
        return ObjectAt(self.object, self.under, self.position, self.radius)


class Recovery:
    """The recovery nodes of one task: `before(subgoal)` for the tree, and the SubTree `definitions` they use.

    `widened` names objects that occupy the place of a target even where they stand only partly on it.
    """

    def __init__(
        self,
        demonstrations: Sequence[Demonstration],
        actions: LearnedActions,
        targets: Sequence[Target],
        widened: frozenset[tuple[Target, str]] = frozenset(),
    ) -> None:
        self.demonstrations, self.actions, self.targets, self.widened = demonstrations, actions, targets, widened
        self.numbers = actions.parameters.recovery
        self.base = demonstrations[0].base_frame
        self.ids = distinct_identifiers({name for d in demonstrations for name in (*d.objects, d.base_frame)})
        self.picks = self._picks()
        self.ups = {name: self._up(name) for name in self.picks}
        self.turned = self._turned()
        self.covers = self._covers()
        self._definitions: dict[str, Definition] = {}

    @property
    def definitions(self) -> list[Definition]:
        """The SubTrees that the nodes given so far use."""
        return list(self._definitions.values())

    def before(self, subgoal: Subgoal, done: Sequence[Target], instead: Sequence[Subgoal] = ()) -> Sequence[Node]:
        """What makes room before a subgoal, unless it or one `instead` of it is done.

        The place is freed, the object uncovered, the hand emptied for it.

        The objects of targets in `done` are known to lie where they belong, since earlier siblings have just checked
        it: they do not occupy the place, and do not cover anything unless what they rest on may itself do so.
        """
        name, place = subgoal.target.object, self.actions.placements[subgoal.target]
        settled = {target.object for target in done} - {name}
        occupied = [condition for condition in self._occupations(subgoal.target) if condition.object not in settled]
        if self._own_target(place.frame):
            occupied += [cover.condition for cover in self._raised(subgoal) if cover.object not in settled]
        grounded = self._grounded(done)
        covers = [cover for cover in self._covers_of(name) if cover.object not in grounded]
        if not occupied and not covers:
            return ()
        tree_id = self._unique(f"{RECOVERY_PREFIX}Room_for_{self.ids[name]}_at_{self.ids[place.frame]}")
        uncovered = sequence(*(_not(cover.condition) for cover in covers)) if covers else None
        clear = [*map(_not, occupied), *([fallback(leaf(InGripper(name)), uncovered)] if uncovered else [])]
        lifts = [_then(condition, self._lift(condition.object)) for condition in occupied]
        lifts += [_then(cover.condition, self._off(cover)) for cover in covers]
        away = sequence(self._put_down(), _first(lifts))
        body = sequence(
            fallback(sequence(*clear), away, reactive=False), fallback(leaf(InGripper(name)), self._put_down())
        )
        finished = [leaf(self.actions.placements[way.target].achieves) for way in (subgoal, *instead)]
        self._definitions[tree_id] = Definition(tree_id, fallback(*finished, body))
        return (subtree(tree_id),)

    def standing(self, subgoal: Subgoal) -> Sequence[Node]:
        """What moves a subgoal's reference away where it was put wrongly, before anything is built in its frame.

        Upon something, or on another target's place: what is built there first would have to be taken down again.
        Only for a reference that the task itself leaves where it is.
        """
        frame = self.actions.placements[subgoal.target].frame
        wrongly = (
            [] if self._own_target(frame) else [*(c.condition for c in self._raised(subgoal)), *self._astray(frame)]
        )
        if not wrongly:
            return ()
        tree_id = f"{RECOVERY_PREFIX}Stand_{self.ids[frame]}"
        clear = sequence(*map(_not, wrongly))
        lifts = _first([_then(condition, self._lift(frame)) for condition in wrongly])
        body = fallback(clear, sequence(self._put_down(), lifts), reactive=False)
        self._definitions[tree_id] = Definition(tree_id, body)
        return (subtree(tree_id),)

    def _astray(self, frame: str) -> list[ObjectAt | ObjectRoughlyAt]:
        """The places of targets that a reference may occupy, but for those that lie in its own frame."""
        apart = [target for target in self.targets if frame not in self._carriers(target)]
        occupied = [condition for target in apart for condition in self._occupations(target)]
        return [condition for condition in occupied if condition.object == frame]

    def _carriers(self, target: Target) -> set[str]:
        """The frame of a target, that of the target which places this frame, and so on."""
        carriers: set[str] = set()
        frames = {self.actions.placements[target].frame}
        while frames - carriers:
            carriers |= frames
            frames = {self.actions.placements[t].frame for t in self.targets if t.object in carriers}
        return carriers

    def _own_target(self, name: str) -> bool:
        return any(target.object == name for target in self.targets)

    def _grounded(self, done: Sequence[Target]) -> set[str]:
        """The objects of targets whose frame cannot be moved by hand, or is grounded itself."""
        grounded: set[str] = set()
        for _ in done:
            grounded |= {t.object for t in done if t.frame not in self.picks or t.frame in grounded}
        return grounded

    def _unique(self, tree_id: str) -> str:
        number, candidate = 1, tree_id
        while candidate in self._definitions:
            number += 1
            candidate = f"{tree_id}_{number}"
        return candidate

    def _picks(self) -> dict[str, Pick]:
        """How to grasp each object that was picked, and with a scene each that a gripper can be thought to span."""
        picks = {name: self.actions.pick(name) for name in self.actions.grasps}
        scene = self.actions.scene
        seen = {name for d in self.demonstrations for name in d.first_seen}
        uprights = {
            name: Upright(shape, self._up(name)) for name, shape in sorted(scene.objects.items()) if name in seen
        } if scene else {}  # fmt: skip
        for name in sorted(set(uprights) - set(picks)):
            grasp = borrowed_grasp(uprights[name], self.actions.grasps, uprights, self.actions.parameters.grasps)
            if grasp is not None:
                hand = rounded_pose(grasp)
                picks[name] = Pick(name, name, hand.position, hand.quaternion_xyzw)
        return picks

    def _turned(self) -> dict[str, Pick]:
        """The grasps turned by a quarter: of square objects, and of those where the narrow side had to be guessed."""
        turned = {}
        scene = self.actions.scene
        for name, pick in self.picks.items() if scene else ():
            shape = scene.objects.get(name) if scene else None
            guessed = (
                name not in self.actions.grasps
                and shape is not None
                and not self._upright(name).is_square(self.actions.parameters.grasps.square_m)
            )
            if guessed or (shape is not None and shape.symmetry in ("cube", "vertical")):
                hand = rounded_pose(quarter_turned(self.actions.grasp_of(pick), self.ups[name]))
                turned[name] = replace(pick, position=hand.position, orientation=hand.quaternion_xyzw)
        return turned

    def _take(self, name: str) -> Node:
        """Picks an object; where the hand meets something beside it, turned by a quarter."""
        if name not in self.turned:
            return leaf(self.picks[name])
        tree_id = f"{RECOVERY_PREFIX}Take_{self.ids[name]}"
        self._definitions[tree_id] = Definition(tree_id, _first([leaf(self.picks[name]), leaf(self.turned[name])]))
        return subtree(tree_id)

    def otherwise(self, subgoal: Subgoal) -> Sequence[Node]:
        """What follows where a subgoal has failed: if the hand is still open, its object is tried turned by a quarter.

        It ends in FAILURE, so that the tree begins anew with the object in hand.
        """
        name = subgoal.target.object
        if name not in self.turned or subgoal.guards or self._turns_others(name):
            return ()
        tree_id = f"{RECOVERY_PREFIX}Turn_for_{self.ids[name]}"
        body = sequence(leaf(GripperIs("open")), leaf(self.turned[name]))
        self._definitions[tree_id] = Definition(tree_id, Node("ForceFailure", (), (body,)))
        return (subtree(tree_id),)

    def _turns_others(self, name: str) -> bool:
        """Whether something belongs beside the object, so that how it is turned decides where."""
        others = (t for t in self.targets if t.object != name and name in t.tied | {t.frame})
        releases = (self.actions.moves[number].release for target in others for number in target.members)
        rests = (r.rest[name].position for r in releases if r and r.rest and name in r.rest)
        up = self.ups[name]
        return any(float(np.linalg.norm(cross(up, np.array(rest)))) > self.numbers.beside_m for rest in rests)

    def _covers(self) -> list[Cover]:
        """Every covering that is possible (with a scene) or was demonstrated, the highest in a pile first."""
        scene = self.actions.scene
        if scene is None:
            upon = {(target.object, *target.upon) for target in self.targets if target.upon}
            return [Cover(x, o, rounded_vector(at), self.numbers.cover_radius_m) for x, o, at in sorted(upon)]
        known = [name for name in self.picks if name in scene.objects]
        heights = {name: self._upright(name).height_m for name in known}
        covers = [
            (heights[o] / 2 + between_m + heights[x] / 2, x, o, between_m == 0.0)
            for o in known
            for x in known
            if x != o
            for between_m in _sums(
                [heights[other] for other in known if other not in (x, o)], self.numbers.levels, self.numbers.merged_m
            )
        ]
        mixed = max(heights.values(), default=0.0) - min(heights.values(), default=0.0) > self.numbers.edge_m
        return [self._cover(*cover, mixed) for cover in sorted(covers, key=lambda cover: -cover[0])]

    def _cover(self, height_m: float, x: str, o: str, direct: bool, mixed: bool) -> Cover:
        """x upon o, its middle so high above that of o; where heights are mixed, others between are told apart."""
        radius = min(PLACE_RADIUS_M, self._upright(o).sides_m[1] / 2 + self.numbers.edge_m)
        position = rounded_vector(self.ups[o] * height_m)
        return Cover(
            x, o, position, rounded(radius if direct or not mixed else min(radius, self.numbers.mixed_radius_m)), direct
        )

    def _upright(self, name: str) -> Upright:
        scene = self.actions.scene
        assert scene is not None
        return Upright(scene.objects[name], self.ups[name])

    def _up(self, name: str) -> Array:
        """The direction (3,), in the object's frame, that points up in the base on average."""
        quaternions = [
            pose.quaternion_xyzw for d in self.demonstrations for pose in (d.first_seen.get(name),) if pose is not None
        ]
        up = rotate(conjugate(np.array(quaternions)), np.array([0.0, 0.0, 1.0])).mean(axis=0)
        norm = float(np.linalg.norm(up))
        return np.asarray(up / norm) if norm > self.numbers.upright else np.array([0.0, 0.0, 1.0])

    def _occupations(self, target: Target) -> list[ObjectAt | ObjectRoughlyAt]:
        """Which other objects may occupy the place of a target. Dropping needs no free place."""
        place = self.actions.placements[target]
        if self.actions.scene is None or not isinstance(place, Place):
            return []
        others = [name for name in sorted(self.picks) if name not in (target.object, place.frame)]
        return [
            ObjectRoughlyAt(name, place.frame, place.rest, self._touching_m(name, target.object))
            if (target, name) in self.widened
            else ObjectAt(name, place.frame, place.rest, self._occupying_m(name, target.object))
            for name in others
        ]

    def _occupying_m(self, a: str, b: str) -> float:
        """The distance [m] of two origins below which one leaves no room for the other."""
        scene = self.actions.scene
        sides = [self._upright(name).sides_m[0] for name in (a, b) if scene and name in scene.objects]
        return rounded(
            min(PLACE_RADIUS_M, self.numbers.occupies * sum(sides) / len(sides) if sides else PLACE_RADIUS_M)
        )

    def _touching_m(self, a: str, b: str) -> float:
        """The distance [m] of two origins below which the outlines may touch, whatever the yaws."""
        scene = self.actions.scene
        sizes = [scene.objects[name].size_m[:2] for name in (a, b) if scene and name in scene.objects]
        return rounded(min(DROP_RADIUS_M, self.numbers.touch_m + sum(float(np.hypot(x, y)) for x, y in sizes) / 2))

    def _raised(self, subgoal: Subgoal) -> list[Cover]:
        """What the reference may have been put upon, so that nothing could be placed beside it.

        Only where it stood on the table whenever the operator placed something in its frame.
        """
        frame = self.actions.placements[subgoal.target].frame
        moves = [self.actions.moves[number] for number in subgoal.target.members]
        heights = [m.release.objects[frame].position[2] for m in moves if m.release and frame in m.release.objects]
        if frame not in self.picks or not heights or self.actions.scene is None:
            return []
        on_table = float(np.median(heights)) < min(self._initial_heights(frame)) + self.numbers.on_table_m
        return [cover for cover in self.covers if cover.object == frame and cover.direct] if on_table else []

    def _covers_of(self, name: str) -> list[Cover]:
        return [cover for cover in self.covers if cover.under == name and cover.object in self.picks]

    def _off(self, cover: Cover, below: tuple[str, ...] = ()) -> Node:
        """Picks a covering object. With a scene the covers of a pile are listed from its top; without, what was shown
        to lie upon the covering object goes first.
        """
        higher = [other for other in self._covers_of(cover.object) if other.object not in below]
        pick = self._take(cover.object)
        if self.actions.scene is not None or not higher:
            return pick
        lifts = [_then(other.condition, self._off(other, (*below, cover.object))) for other in higher]
        return _first([*lifts, pick])

    def _lift(self, name: str) -> Node:
        """Picks the object, or what lies highest upon it."""
        covers = self._covers_of(name)
        if not covers:
            return self._take(name)
        tree_id = f"{RECOVERY_PREFIX}Lift_{self.ids[name]}"
        lifts = [_then(cover.condition, self._off(cover, (name,))) for cover in covers]
        self._definitions[tree_id] = Definition(tree_id, _first([*lifts, self._take(name)]))
        return subtree(tree_id)

    def _put_down(self) -> Node:
        """The SubTree that empties and opens the gripper: what it holds is set down on the first free spot."""
        if PUT_DOWN not in self._definitions:
            ports = tuple(sorted(self._around(np.zeros(2))))
            self._definitions[SPOT_FREE] = Definition(SPOT_FREE, self._spot_is_free(), ports)
            spots = [self._put_on(spot) for spot in self._spots()]
            body = fallback(leaf(GripperIs("open")), _first(spots), leaf(SetGripper("open")))
            self._definitions[PUT_DOWN] = Definition(PUT_DOWN, body)
        return subtree(PUT_DOWN)

    def _put_on(self, spot: Array) -> Node:
        """Places what is held on a spot (2,), if that is free."""
        places = []
        for name in sorted(self.picks):
            pose = self._pose_on_table(name, spot)
            hand = rounded_pose(pose @ self.actions.grasp_of(self.picks[name]))
            place = Place(name, self.base, hand.position, hand.quaternion_xyzw, rounded_vector(pose.position))
            places.append(_then(InGripper(name), leaf(place)))
        return sequence(subtree(SPOT_FREE, **self._around(spot)), _first(places), reactive=False)

    def _around(self, spot: Array) -> dict[str, Value]:
        """The ports of SpotIsFree: the spot, and, where wide objects are known, six points around it."""
        ports: dict[str, Value] = {"position": rounded_vector((spot[0], spot[1], 0.0))}
        for k in range(self.numbers.ring if self._wide() else 0):
            angle = 2 * np.pi * k / self.numbers.ring
            x, y = spot + self.numbers.ring_m * np.array([np.cos(angle), np.sin(angle)])
            ports[f"position_{k + 1}"] = rounded_vector((x, y, 0.0))
        return ports

    def _wide(self) -> list[str]:
        scene = self.actions.scene
        return (
            [name for name, shape in sorted(scene.objects.items()) if max(shape.size_m) > self.numbers.wide_m]
            if scene
            else []
        )

    def _spots(self) -> list[Array]:
        """Spots (2,) in the base where objects have lain and the robot has reached.

        Not the outermost, so that what belongs beside what is put there stays in reach; far from the places that the
        task itself needs, and from one another.
        """
        seen = np.array(
            [
                d.first_seen[name].position[:2]
                for d in self.demonstrations
                for name in d.first_seen
                if name in self.picks
            ]
        )
        outside = np.linalg.norm(seen - np.median(seen, axis=0), axis=1)
        inside = seen[
            np.argsort(outside, kind="stable")[: max(self.numbers.spots, round(self.numbers.inner * len(seen)))]
        ]
        places = [np.array(self.actions.placements[t].rest[:2]) for t in self.targets if t.frame == self.base]
        chosen: list[Array] = [] if places else [inside[0]]
        while len(chosen) < min(self.numbers.spots, len(inside)):
            away = np.linalg.norm(inside[:, None] - np.array([*places, *chosen])[None], axis=2).min(axis=1)
            chosen.append(inside[int(np.argmax(away))])
        return chosen

    def _pose_on_table(self, name: str, spot: Array) -> Pose:
        """The pose of an object that stands on the table, a little raised, oriented as it was first seen."""
        poses = [d.first_seen[name] for d in self.demonstrations if name in d.first_seen]
        lowest = min(poses, key=lambda pose: pose.position[2])
        height = min(self._initial_heights(name))
        return Pose.of((spot[0], spot[1], height + self.numbers.raised_m), lowest.quaternion_xyzw)

    def _initial_heights(self, name: str) -> list[float]:
        """Heights [m] at which the object, or one of the same shape, was first seen."""
        scene = self.actions.scene
        alike = [
            other
            for other in self.picks
            if other == name or (scene and scene.objects.get(other) == scene.objects.get(name))
        ]
        return [
            d.first_seen[other].position[2] for d in self.demonstrations for other in alike if other in d.first_seen
        ]

    def _spot_is_free(self) -> Node:
        """No object is near the spot at the port `position`, no wide one near the points around it."""
        names = sorted({name for d in self.demonstrations for name in d.objects})
        checks = [self._near(name, "position") for name in names]
        checks += [self._near(name, f"position_{k + 1}") for name in self._wide() for k in range(self.numbers.ring)]
        return sequence(*(Node("Inverter", (), (check,)) for check in checks))

    def _near(self, name: str, port: str) -> Node:
        template = leaf(ObjectRoughlyAt(name, self.base, (0.0, 0.0, 0.0), DROP_RADIUS_M))
        return replace(template, ports=tuple(sorted({**dict(template.ports), "position": f"{{{port}}}"}.items())))


def _sums(heights_m: Sequence[float], levels: int, merged_m: float) -> list[float]:
    """How high [m] none to `levels` - 1 things of these heights may be upon each other; sums nearer than
    `merged_m` [m] count as one.
    """
    sums = sorted({round(sum(some), 3) for n in range(1, levels) for some in combinations(heights_m, n)})
    merged: list[list[float]] = []
    for total in sums:
        if merged and total - merged[-1][0] < merged_m:
            merged[-1].append(total)
        else:
            merged.append([total])
    return [0.0, *(float(np.mean(group)) for group in merged)]


def _not(condition: Condition) -> Node:
    return Node("Inverter", (), (leaf(condition),))


def _then(condition: Condition, action: Node) -> Node:
    """The action if the condition holds; with memory, so that the action may end what it was begun for."""
    return sequence(leaf(condition), action, reactive=False)


def _first(nodes: Sequence[Node]) -> Node:
    """The first that does not fail; with memory, so that what runs is not given up for an earlier one."""
    return nodes[0] if len(nodes) == 1 else fallback(*nodes, reactive=False)
