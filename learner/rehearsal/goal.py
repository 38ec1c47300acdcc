"""What a group of demonstrations means, in the terms of the stage, and whether that is reached by the world's truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from learner.inference.goals import Group
from learner.inference.targets import Target
from learner.model import Drop, ObjectAt, Place, Pose
from learner.model.condition import DROP_RADIUS_M, PLACE_RADIUS_M, ObjectPosedAt, ObjectRoughlyAt
from learner.model.turning import turned_rad
from learner.model.upright import Spot
from learner.rehearsal.stage import Stage
from learner.simulation.arena import Arena, Truth
from learner.simulation.gravity import Table

Relation = ObjectAt | ObjectRoughlyAt


@dataclass(frozen=True)
class Goal:
    """What one group of demonstrations means, in the stage's terms: `relations` that hold together at the end, what
    is `held` then, how many `actions` an undisturbed run takes, `meanwhile` the relations that guard others or are
    reached on the way, and `stops`: relations reached in the end, each with those that are reached before, in order.
    """

    relations: tuple[Relation, ...]
    held: str | None = None
    actions: int = 0
    meanwhile: tuple[Relation, ...] = ()
    stops: tuple[tuple[Relation, tuple[Relation, ...]], ...] = ()

    def reached(self, world: Arena) -> bool:
        """Whether it is, by the truth."""
        return world.held == self.held and all(holds(relation, world) for relation in self.relations)

    def place(self, relation: Relation, world: Arena) -> Spot:
        """Where the object of a relation shall be once all of it is reached."""
        chain = [relation]
        while frame := next((r for r in self.relations if r.object == chain[-1].frame and r not in chain), None):
            chain.append(frame)
        spot = world.spot(chain[-1].frame)
        for link in reversed(chain):
            yaw = Spot.of(Pose((0.0, 0.0, 0.0), link.orientation)).yaw if isinstance(link, ObjectPosedAt) else 0.0
            spot = spot.compose(Spot(*link.position, yaw))
        return spot

    def reached_in(self, world: Arena) -> Table:
        """A table on which everything is where the goal wants it."""
        places = {relation.object: self.place(relation, world) for relation in self.relations}
        return Table(world.bodies, {**world.table.spots, **places}, world.table.rng)

    @property
    def grounded(self) -> list[ObjectAt]:
        """The relations to frames that the goal itself leaves where they are: their places are known beforehand."""
        relations = (*self.relations, *self.meanwhile)
        return [r for r in relations if isinstance(r, ObjectAt) and r.frame not in self.objects]

    @property
    def objects(self) -> list[str]:
        """What is moved."""
        return sorted({relation.object for relation in self.relations})


def goals_of(groups: Sequence[Group], placements: Mapping[Target, Place | Drop], stage: Stage) -> list[Goal]:
    """The goal of each group."""
    return [_goal(group, placements, stage) for group in groups]


def _goal(group: Group, placements: Mapping[Target, Place | Drop], stage: Stage) -> Goal:
    def on(target: Target) -> Relation:
        return on_stage(placements[target].achieves, stage)

    targets = [subgoal.targets() for subgoal in group.subgoals]
    return Goal(
        relations=tuple(on(subgoal.target) for subgoal in group.subgoals),
        held=group.held,
        actions=2 * sum(map(len, targets)) + (group.held is not None),
        meanwhile=tuple(on(target) for each in targets for target in each[:-1]),
        stops=tuple((on(each.target), tuple(map(on, each.stops))) for each in group.subgoals if each.stops),
    )


def on_stage(relation: Relation, stage: Stage) -> Relation:
    """In the stage's terms, with the paper's radius: what the task means does not depend on what the tree looks for.

    The truth may lie a little outside of it: the camera may have seen it within.
    """
    widest = PLACE_RADIUS_M if isinstance(relation, ObjectAt) else DROP_RADIUS_M
    radius = widest + stage.parameters.judging.slack_m
    there = replace(relation, position=stage.point(relation.frame, relation.position), radius=radius)
    if not isinstance(there, ObjectPosedAt):
        return there
    orientation = stage.turned(there.frame, there.object, there.orientation)
    return replace(there, orientation=orientation, angle=there.angle + stage.parameters.judging.slack_rad)


def holds(relation: Relation, world: Truth) -> bool:
    """Whether a relation holds, by the truth."""
    at = world.spot(relation.frame).relative(world.spot(relation.object))
    x, y, z = relation.position
    away_m = math.hypot(at.x - x, at.y - y, 0.0 if isinstance(relation, ObjectRoughlyAt) else at.z - z)
    near = world.held != relation.object and away_m <= relation.radius
    if not near or not isinstance(relation, ObjectPosedAt):
        return near
    turned = Spot(0.0, 0.0, 0.0, at.yaw).pose().quaternion_xyzw
    symmetry = world.bodies[relation.object].shape.symmetry
    return turned_rad(turned, relation.orientation, symmetry) <= relation.angle
