"""A draft: what was understood, from which our method makes the tree, once more for each repair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from learner.inference.goals import Group, Subgoal
from learner.inference.targets import Target
from learner.inference.understanding import Understanding
from learner.model import Drop, InGripper, Node, Place, Tree
from learner.model.condition import DROP_RADIUS_M, PLACE_RADIUS_M
from learner.model.tree import fallback, leaf, sequence
from learner.planning.actions import LearnedActions
from learner.planning.demonstrated import DemonstratedRecovery
from learner.planning.obstacles import Obstacles
from learner.planning.parameters import PlanningParameters
from learner.planning.recovery import NoRecovery
from learner.planning.relational import RelationalRecovery
from learner.planning.repairs import NOTHING, Repairs
from learner.planning.synthesis import main_id, tree_of
from learner.relations.grasping import Grasp
from learner.relations.things import NO_THINGS, Things


@dataclass(frozen=True)
class Draft:
    """`understood` is what all demonstrations mean, `without` for each of several users what those of the others mean
    (None where they are too few, or mean nothing).
    """

    understood: Understanding
    parameters: PlanningParameters
    without: Mapping[str, Understanding | None]

    def tree(self, repairs: Repairs = NOTHING) -> Tree:
        """The tree, with what a rehearsal has taught."""
        understood = self.understood
        actions = self.actions
        groups = [replace(group, subgoals=in_order(group, repairs)) for group in understood.groups]
        return tree_of(main_id(understood.demonstrations), groups, actions, self.recovery(actions))

    @property
    def grasps(self) -> tuple[Grasp, ...]:
        """Where the tree's queries for a grasp are answered from."""
        return Obstacles(self.understood.demonstrations, self.actions).grasps

    @property
    def things(self) -> Things:
        """What the proof is to know of the objects."""
        recovery = self.recovery(self.actions)
        if not isinstance(recovery, RelationalRecovery):
            return NO_THINGS
        picks = recovery.obstacles.picks
        return Things({name: self.actions.grasp_of(pick) for name, pick in picks.items()}, recovery.upon)

    def recovery(self, actions: LearnedActions) -> RelationalRecovery | DemonstratedRecovery:
        """By relations, where shapes are known."""
        obstacles = Obstacles(self.understood.demonstrations, actions)
        if obstacles.has_scene:
            return RelationalRecovery(obstacles, self.shared_targets())
        subgoals = [each for group in self.understood.groups for subgoal in group.subgoals for each in subgoal.every()]
        return DemonstratedRecovery(
            obstacles, self.shared_targets(), [stop for each in subgoals for stop in each.stops]
        )

    def shared_targets(self) -> list[Target]:
        """The targets that a demonstration of some group reached; not those of somebody who means another task."""
        understood = self.understood
        counted = {number for group in understood.groups for number in group.demonstrations}
        of = understood.moves.demonstration
        return [t for t in understood.targets if not counted.isdisjoint(of[list(t.members)].tolist())]

    def nominal_tree(self) -> Tree:
        """The tree without the SubTrees that only recover; much faster made than those are."""
        groups, actions = self.understood.groups, self.actions
        return tree_of(main_id(self.understood.demonstrations), groups, actions, NoRecovery())

    @cached_property
    def actions(self) -> LearnedActions:
        """The actions as they were demonstrated; worked out once, since nothing changes them."""
        return LearnedActions(self.understood.moves, self.understood.targets, self.parameters)

    @property
    def placements(self) -> Mapping[Target, Place | Drop]:
        """How each target is reached, as it was demonstrated."""
        return self.actions.placements

    @cached_property
    def goal(self) -> Node:
        """Where a tree may say SUCCESS: all that holds at the end of some group, with the paper's radii."""
        widest = {Place: PLACE_RADIUS_M, Drop: DROP_RADIUS_M}
        ways = []
        for group in self.understood.groups:
            reached = [self.placements[subgoal.target] for subgoal in group.subgoals]
            relations = [leaf(replace(place.achieves, radius=widest[type(place)])) for place in reached]
            ways.append(sequence(*relations, *([leaf(InGripper(group.held))] if group.held else [])))
        return fallback(*ways)

    def orders(self, repairs: Repairs = NOTHING) -> list[list[Target]]:
        """The goals of each group as the tree pursues them."""
        return [[subgoal.target for subgoal in in_order(group, repairs)] for group in self.understood.groups]


def in_order(group: Group, repairs: Repairs) -> tuple[Subgoal, ...]:
    """The subgoals, each that is to come before another moved before it; what contradicts itself stays as it is."""
    left, found = list(group.subgoals), []
    while left:
        free = [s for s in left if not any((other.target, s.target) in repairs.before for other in left)]
        found.append((free or left)[0])
        left.remove(found[-1])
    return tuple(found)
