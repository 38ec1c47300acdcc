"""The tree of our method: what backchaining unfolds to, with each condition checked once (paper, section III-C).

A target becomes Fallback(condition, Sequence(guards, hold the object, place it)) and holding an object
Fallback(InGripper, Sequence(Fallback(GripperIs open, SetGripper open), Pick)): 11 nodes a target. Goals stand in a
reactive Sequence in an order in which each is reached without undoing those before it, so that what an earlier one
has established is not checked again; that the gripper is free at the end follows, since a placed object is one that
is not held.

The Fallback of a target has memory: an object that lies within the noise of a radius seems now placed, now not, and is
then taken and placed once rather than reached for and let be again and again. Making room for it is not done with
memory, so that one wrong look does not take a tower apart.

Where an object is brought to stops on its way, its chain is a Sequence with memory: each stop as a target of its own,
then the object in hand and placed. What was visited is so not visited again until something fails or is disturbed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from learner.inference.goals import Group, Subgoal
from learner.model import Definition, Demonstration, Drop, GripperIs, Node, Place, SetGripper, Tree
from learner.model.names import NODES, identifier
from learner.model.tree import Value, fallback, is_recovery, leaf, sequence, subtree
from learner.model.vocabulary import RECOVERY_PREFIX
from learner.planning.actions import LearnedActions
from learner.planning.recovery import Recovery

HOLD = "Hold"
HOLD_PORTS = ("object", "orientation", "position")


def main_id(demonstrations: Sequence[Demonstration]) -> str:
    """The ID of the main tree: the task's name, with a 'T' before it where no main tree can be called so.

    That is, where it begins with a digit, is the name of a node, or that of a SubTree that may stand beside it.
    """
    name = identifier(demonstrations[0].task)
    taken = name in NODES or name == HOLD or name.startswith(RECOVERY_PREFIX)
    return f"T{name}" if taken or name[0].isdigit() else name


def tree_of(tree_id: str, groups: Sequence[Group], actions: LearnedActions, recovery: Recovery) -> Tree:
    """The tree of all groups: any finished goal is left alone, else the first that can be reached is pursued.

    What all groups begin or end with stands once; between them the goals are tested before any is pursued.
    """
    builder = _Builder(groups, actions, recovery)
    main = Definition(tree_id, builder.root())
    holding = Definition(HOLD, hold_body("{object}", "{position}", "{orientation}"), HOLD_PORTS)
    return _without_unused(Tree(main, (holding, *recovery.definitions, *builder.definitions.values())))


class _Builder:
    """Builds the root of one tree."""

    def __init__(self, groups: Sequence[Group], actions: LearnedActions, recovery: Recovery) -> None:
        self.groups, self.actions, self.recovery = groups, actions, recovery
        self.definitions: dict[str, Definition] = {}
        """The SubTrees that recover, used so far."""

    def root(self) -> Node:
        first, alike = self.groups[0], len({group.held for group in self.groups}) == 1
        if len(self.groups) == 1:
            begun = self.recovery.first(first.subgoals)
            return sequence(*begun, *self._subgoals(first.subgoals, ()), *self._held(first))
        lists = [group.subgoals for group in self.groups]
        begin = _common(lists) if alike else 0
        end = _common([subgoals[begin:][::-1] for subgoals in lists]) if alike else 0
        middles = [subgoals[begin : len(subgoals) - end] for subgoals in lists]
        choice = self._choice(middles, first.subgoals[:begin])
        before, after = first.subgoals[:begin], first.subgoals[len(first.subgoals) - end :]
        nodes = [*self._subgoals(before, ()), *choice, *self._subgoals(after, before), *self._held(first)]
        return _in_turn(*nodes)

    def _choice(self, middles: Sequence[Sequence[Subgoal]], done: Sequence[Subgoal]) -> Sequence[Node]:
        """One of several ways: a finished one is left alone, else the first that does not fail is pursued.

        The Fallback over the ways has memory, so that one way is not given up for another while it runs. Ways of
        several subgoals after the first are pursued as long as the tree stays within eleven nodes a placement.
        """
        if all(len(middle) == 1 for middle in middles):
            return self._choice_of([middle[0] for middle in middles], done)
        tests = [self._test(middle) for middle in middles[1:]]
        ways = [sequence(*self._subgoals(middle, done)) for middle in middles]
        pursued = ways[:1]
        for way in ways[1:]:
            longer = fallback(*tests, fallback(*pursued, way, reactive=False))
            if self._nominal_size(longer) <= self._bound(middles):
                pursued.append(way)
        first = pursued[0] if len(pursued) == 1 else fallback(*pursued, reactive=False)
        return (fallback(*tests, first),)

    def _choice_of(self, subgoals: Sequence[Subgoal], done: Sequence[Subgoal]) -> Sequence[Node]:
        """One of several subgoals; guards that all share stand once, room for the first is made as by `_subgoals`."""
        first, *others = subgoals
        tests = [self._condition(subgoal) for subgoal in subgoals]
        if first.guards and {subgoal.guards for subgoal in others} == {first.guards}:
            guards, known = self._subgoals(first.guards, done), (*done, *first.guards)
            chains = [_in_turn(*self._room(subgoal, known), *self._placed(subgoal, known)) for subgoal in subgoals]
            return (fallback(*tests, sequence(*guards, fallback(*chains, reactive=False)), reactive=False),)
        room = () if first.guards else self._room(first, done, others)
        chain = self._chain(first, done) if first.guards else _in_turn(*self._placed(first, done))
        chains = [chain, *(self._chain(subgoal, done) for subgoal in others)]
        return (*room, fallback(*tests, *chains, reactive=False))

    def _bound(self, middles: Sequence[Sequence[Subgoal]]) -> int:
        placements = {target for middle in middles for subgoal in middle for target in subgoal.targets()}
        return 11 * len(placements) + len(middles)

    def _nominal_size(self, node: Node) -> int:
        """The size of a node, Hold unfolded and recovery left out."""
        holding = hold_body("o", "p", "q").size
        unfolded = (holding if n.id == HOLD else 0 if is_recovery(n) else 1 for n in node.walk())
        return sum(unfolded)

    def _test(self, subgoals: Sequence[Subgoal]) -> Node:
        conditions = [self._condition(subgoal) for subgoal in subgoals]
        return conditions[0] if len(conditions) == 1 else sequence(*conditions)

    def _held(self, group: Group) -> list[Node]:
        return [hold(group.held, self.actions)] if group.held else []

    def _subgoals(self, subgoals: Sequence[Subgoal], done: Sequence[Subgoal]) -> list[Node]:
        """Steps in a row; `done` are those that earlier siblings have just checked."""
        nodes: list[Node] = []
        for place, subgoal in enumerate(subgoals):
            earlier = (*done, *subgoals[:place])
            nodes += [node for node in self.recovery.standing(subgoal) if node not in nodes]
            nodes += () if subgoal.guards else self._room(subgoal, earlier)
            chain = self._chain(subgoal, earlier) if subgoal.guards else _in_turn(*self._placed(subgoal, earlier))
            otherwise = self.recovery.otherwise(subgoal)
            nodes.append(fallback(self._condition(subgoal), chain, *otherwise, reactive=False))
        return nodes

    def _condition(self, subgoal: Subgoal) -> Node:
        return leaf(self._placement(subgoal).achieves)

    def _chain(self, subgoal: Subgoal, done: Sequence[Subgoal]) -> Node:
        """The guards, room made, the object in hand, and the placement."""
        guards = self._subgoals(subgoal.guards, done)
        known = (*done, *subgoal.guards)
        return _in_turn(*guards, *self._room(subgoal, known), *self._placed(subgoal, known))

    def _room(self, subgoal: Subgoal, done: Sequence[Subgoal], instead: Sequence[Subgoal] = ()) -> Sequence[Node]:
        room = self.recovery.before(subgoal, [other.target for other in done], instead)
        if room is None or isinstance(room, Node):
            return () if room is None else (room,)
        used = replace(room, id=self._unused(room.id))
        self.definitions[used.id] = used
        return (subtree(used.id),)

    def _unused(self, tree_id: str) -> str:
        """The ID, with a number if it was used before."""
        number, candidate = 1, tree_id
        while candidate in self.definitions:
            number += 1
            candidate = f"{tree_id}_{number}"
        return candidate

    def _placed(self, subgoal: Subgoal, done: Sequence[Subgoal]) -> Sequence[Node]:
        """The object in hand and placed; with memory, where it is brought to stops before, each once."""
        placed = (hold(subgoal.target.object, self.actions), leaf(self._placement(subgoal)))
        if not subgoal.stops:
            return placed
        stops = (self._visited(Subgoal(stop), done) for stop in subgoal.stops)
        return (sequence(*stops, *placed, reactive=False),)

    def _visited(self, stop: Subgoal, done: Sequence[Subgoal]) -> Node:
        """A stop reached, unless the object is there."""
        chain = sequence(*self._room(stop, done), *self._placed(stop, done))
        return fallback(self._condition(stop), chain, reactive=False)

    def _placement(self, subgoal: Subgoal) -> Place | Drop:
        return self.actions.placements[subgoal.target]


def _common(lists: Sequence[Sequence[Subgoal]]) -> int:
    """How many first subgoals all lists share."""
    return next((k for k, firsts in enumerate(zip(*lists, strict=False)) if len(set(firsts)) > 1), min(map(len, lists)))


def _in_turn(*nodes: Node) -> Node:
    """A reactive Sequence; of one node, that node."""
    return nodes[0] if len(nodes) == 1 else sequence(*nodes)


def hold(name: str, actions: LearnedActions) -> Node:
    """The use of the SubTree that takes an object in hand."""
    pick = actions.pick(name)
    return subtree(HOLD, object=name, position=pick.position, orientation=pick.orientation)


def hold_body(name: Value, position: Value, orientation: Value) -> Node:
    """Fallback(InGripper, Sequence(open the gripper, Pick)), the object picked in its own frame."""
    pose = (("object", name), ("frame", name), ("position", position), ("orientation", orientation))
    opened = fallback(leaf(GripperIs("open")), leaf(SetGripper("open")))
    picked = sequence(opened, Node("Pick", tuple(sorted(pose))))
    return fallback(Node("InGripper", (("object", name),)), picked)


def _without_unused(tree: Tree) -> Tree:
    """The tree without SubTrees that nothing uses."""
    used: set[str] = set()
    queue = [tree.main]
    while queue:
        for node in queue.pop().root.walk():
            if node.id is not None and node.id not in used:
                used.add(node.id)
                queue.append(tree.definitions[node.id])
    return Tree(tree.main, tuple(definition for definition in tree.subtrees if definition.id in used))
