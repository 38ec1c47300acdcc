"""Recovery by relations: a handful of SubTrees that ask what lies where, the same for any number of objects.

With a scene, whatever covers an object, takes the room where it is to come down, or keeps its reference from the table
is found by a query of vocabulary 2, taken by a grasp that the manifest lists, and put aside on a free spot. All of it
stands in SubTrees whose ID begins with `Recover_`. Fallbacks over an action have memory, so that lifting an object off
does not end the action that lifts it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from learner.inference.goals import Subgoal
from learner.inference.targets import Target
from learner.model import Definition, Drop, Node, Place
from learner.model.condition import ObjectPosedAt
from learner.model.pose import Array, Vector, cross
from learner.model.tree import asked, fallback, leaf, negated, sequence, subtree
from learner.model.vocabulary import RECOVERY_PREFIX
from learner.planning.obstacles import Obstacles
from learner.planning.rounding import rounded_vector

PUT_DOWN: Final = f"{RECOVERY_PREFIX}PutDown"
ROOM: Final = f"{RECOVERY_PREFIX}Room"
CLEAR: Final = f"{RECOVERY_PREFIX}Clear"
REACH: Final = f"{RECOVERY_PREFIX}Reach"
STAND: Final = f"{RECOVERY_PREFIX}Stand"
AGAIN: Final = f"{RECOVERY_PREFIX}Again"
PLACE_PORTS: Final = ("frame", "object", "position", "radius")


@dataclass(frozen=True, eq=False)
class RelationalRecovery:
    """Takes off what covers, frees what is occupied, and stands references on the table again."""

    obstacles: Obstacles
    targets: Sequence[Target]

    @property
    def definitions(self) -> Sequence[Definition]:
        """All SubTrees; those that nothing uses are left out of the tree."""
        base = self.obstacles.base
        return [
            Definition(PUT_DOWN, put_down_body(base)),
            Definition(ROOM, unless_placed(room_body()), PLACE_PORTS),
            Definition(f"{ROOM}_for", room_body(), PLACE_PORTS[:3]),
            Definition(CLEAR, unless_placed(clear_body()), PLACE_PORTS),
            Definition(REACH, reach_body(), ("object",)),
            Definition(STAND, stand_body(), ("object",)),
            Definition(AGAIN, again_body(), ("object",)),
        ]

    def first(self, subgoals: Sequence[Subgoal]) -> Sequence[Node]:
        """Frees the places that stay where they are, if a reference might stand on one: what is built in its frame
        would have to be taken down again.
        """
        if not any(self._is_loose(subgoal.target.frame) for subgoal in subgoals):
            return ()
        placements = self.obstacles.actions.placements
        fixed = [subgoal.target for subgoal in subgoals if subgoal.target.frame not in self.obstacles.picks]
        return [self._at(CLEAR, place) for t in fixed if isinstance(place := placements[t], Place)]

    def before(self, subgoal: Subgoal, done: Sequence[Target], instead: Sequence[Subgoal] = ()) -> Node | Definition:
        """The place is freed, the object uncovered, the hand emptied for it."""
        target, placements = subgoal.target, self.obstacles.actions.placements
        place = placements[target]
        if isinstance(place, Place) and not instead and not isinstance(place.achieves, ObjectPosedAt):
            return self._at(ROOM, place)
        finished = [leaf(placements[way.target].achieves) for way in (subgoal, *instead)]
        ids = self.obstacles.ids
        name = f"{ROOM}_for_{ids[target.object]}_at_{ids[target.frame]}"
        return Definition(name, fallback(*finished, self._cleared(place)))

    def _cleared(self, place: Place | Drop) -> Node:
        """What is in the way of a place, or over the mouth of the open thing into which something is dropped."""
        position = place.rest if isinstance(place, Place) else self._mouth(place)
        if position is None:
            return subtree(REACH, object=place.object)
        return subtree(f"{ROOM}_for", object=place.object, frame=place.frame, position=position)

    def _mouth(self, drop: Drop) -> Vector | None:
        """Where an object would rest on the rim of the open thing above where it is dropped; None if there is none."""
        shapes = self.obstacles.shapes
        box, own = shapes.get(drop.frame), shapes.get(drop.object)
        if box is None or own is None or not box.open:
            return None
        up, rest = self.obstacles.up(drop.frame), np.array(drop.rest)
        height = self.obstacles.height_m(drop.frame) / 2 + self.obstacles.height_m(drop.object) / 2
        return rounded_vector(rest + up * (height - float(rest @ up)))

    def _at(self, tree_id: str, place: Place) -> Node:
        return subtree(tree_id, object=place.object, frame=place.frame, position=place.rest, radius=place.radius)

    def standing(self, subgoal: Subgoal) -> Sequence[Node]:
        """Sets a subgoal's reference on the table, where it stood whenever the operator placed something in its frame.

        Only for one that the task itself leaves where it is.
        """
        frame = subgoal.target.frame
        return [subtree(STAND, object=frame)] if self._is_loose(frame) and self._stood(subgoal) else []

    def otherwise(self, subgoal: Subgoal) -> Sequence[Node]:
        """If the hand is still open, the next of the object's grasps is tried.

        It ends in FAILURE, so that the tree begins anew with the object in hand.
        """
        name = subgoal.target.object
        turned = len(self.obstacles.turned.get(name, ())) > 0
        if not turned or subgoal.guards or self._turns_others(name):
            return []
        return [subtree(AGAIN, object=name)]

    def _stood(self, subgoal: Subgoal) -> bool:
        obstacles, frame = self.obstacles, subgoal.target.frame
        stood = obstacles.actions.moves.releases(subgoal.target.members).origin(frame)
        heights = stood.positions[stood.known, 2]
        highest = min(obstacles.first_heights_m(frame)) + obstacles.parameters.on_table_m
        return len(heights) > 0 and float(np.median(heights)) < highest

    def _is_loose(self, name: str) -> bool:
        """Whether a frame is an object that can be moved and that the task itself leaves where it is."""
        return name in self.obstacles.picks and not any(target.object == name for target in self.targets)

    def _turns_others(self, name: str) -> bool:
        """Whether something belongs beside the object, so that how it is turned decides where."""
        others = (t for t in self.targets if t.object != name and name in t.tied | {t.frame})
        moves = self.obstacles.actions.moves
        rests = np.concatenate([np.empty((0, 3)), *(moves.releases(t.members).rest(name).positions for t in others)])
        up, beside_m = self.obstacles.ups[name], self.obstacles.parameters.beside_m
        return bool((np.linalg.norm(cross(up, rests), axis=1) > beside_m).any())

    @cached_property
    def upon(self) -> dict[tuple[str, str], Vector]:
        """Where the origin of each obstacle of known height is when it lies upon another [m], in that one's frame."""
        known = [name for name in self.obstacles.picks if name in self.obstacles.shapes]
        return {(a, b): self._upon(a, b) for a in known for b in known if a != b}

    def _upon(self, a: str, b: str) -> Vector:
        ups: Array = self.obstacles.ups[b]
        return rounded_vector(ups * (self.obstacles.height_m(a) + self.obstacles.height_m(b)) / 2)


def put_down_body(base: str) -> Node:
    """The gripper is opened; what it holds is set down on a free spot before."""
    aside = (
        asked("FindHeld", object="{held}"),
        asked("FindSpot", object="{held}", position="{p}", orientation="{q}"),
        Node("Place", (("frame", base), ("object", "{held}"), ("orientation", "{q}"), ("position", "{p}"))),
    )
    opened = (Node("GripperIs", (("state", "open"),)), Node("SetGripper", (("state", "open"),)))
    return fallback(opened[0], sequence(*aside, reactive=False), opened[1], reactive=False)


def unless_placed(body: Node) -> Node:
    """A body for an object that does not lie at its place."""
    there = Node("ObjectAt", tuple((port, f"{{{port}}}") for port in PLACE_PORTS))
    return fallback(there, body)


def room_body() -> Node:
    """Nothing is in the way of the object's place, nothing lies upon it, and the hand is free for it."""
    clear = sequence(negated(_in_the_way()), _uncovered())
    return sequence(fallback(clear, _lifted(), reactive=False), _free_for_it())


def clear_body() -> Node:
    """Nothing is in the way of the object's place."""
    return fallback(negated(_in_the_way()), _lifted(), reactive=False)


def reach_body() -> Node:
    """Nothing lies upon the object, and the hand is free for it."""
    return sequence(fallback(_uncovered(), _lifted(), reactive=False), _free_for_it())


def stand_body() -> Node:
    """The object lies upon nothing; else it is lifted, after the topmost of what lies upon itself."""
    upon = asked("FindUpon", object="{object}", found="{x}")
    itself = sequence(negated(upon), *_picked("{object}"), reactive=False)
    topmost = sequence(upon, *_picked("{x}"), reactive=False)
    lifted = sequence(subtree(PUT_DOWN), fallback(itself, topmost, reactive=False), reactive=False)
    return fallback(negated(asked("FindUnder", object="{object}", found="{under}")), lifted, reactive=False)


def again_body() -> Node:
    """Picks the object by its next grasp, and fails."""
    body = sequence(Node("GripperIs", (("state", "open"),)), *_picked("{object}"), reactive=False)
    return Node("ForceFailure", (), (body,))


def _in_the_way() -> Node:
    return asked("FindInTheWay", object="{object}", frame="{frame}", position="{position}", found="{x}")


def _uncovered() -> Node:
    held = Node("InGripper", (("object", "{object}"),))
    return fallback(held, negated(asked("FindUpon", object="{object}", found="{x}")))


def _lifted() -> Node:
    """Takes what was found, with an empty hand."""
    return sequence(subtree(PUT_DOWN), *_picked("{x}"), reactive=False)


def _free_for_it() -> Node:
    return fallback(Node("InGripper", (("object", "{object}"),)), subtree(PUT_DOWN))


def _picked(name: str) -> tuple[Node, Node]:
    grasp = asked("FindGrasp", object=name, position="{p}", orientation="{q}")
    return grasp, Node("Pick", (("frame", name), ("object", name), ("orientation", "{q}"), ("position", "{p}")))
