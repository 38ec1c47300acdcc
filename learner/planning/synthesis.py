"""The tree of our method: what backchaining unfolds to, with each condition checked once (paper, section III-C).

A target becomes Fallback(condition, Sequence(guards, hold the object, place it)) and holding an object
Fallback(InGripper, Sequence(Fallback(GripperIs open, SetGripper open), Pick)): 11 nodes a target. Goals stand in a
reactive Sequence in an order in which each is reached without undoing those before it, so that what an earlier one
has established is not checked again; that the gripper is free at the end follows, since a placed object is one that
is not held.

The Fallback of a target has memory: an object that lies within the noise of a radius seems now placed, now not, and is
then taken and placed once rather than reached for and let be again and again. Making room for it is not done with
memory, so that one wrong look does not take a tower apart.
"""

from __future__ import annotations

from collections.abc import Sequence

from learner.inference.goals import Group, Step
from learner.model import Definition, Demonstration, Drop, GripperIs, Node, Place, SetGripper, Tree
from learner.model.names import identifier
from learner.model.tree import Value, fallback, is_recovery, leaf, sequence, subtree
from learner.planning.actions import Executables
from learner.planning.recovery import Recovery

HOLD = "Hold"
HOLD_PORTS = ("object", "orientation", "position")


def main_id(demonstrations: Sequence[Demonstration]) -> str:
    """The ID of the main tree: the task's name; one that begins with a digit gets a 'T' before it."""
    name = identifier(demonstrations[0].task)
    return name if not name[0].isdigit() else f"T{name}"


def tree_of(tree_id: str, groups: Sequence[Group], actions: Executables, recovery: Recovery) -> Tree:
    """The tree of all groups: any finished goal is left alone, else the first that can be reached is pursued.

    What all groups begin or end with stands once; between them the goals are tested before any is pursued.
    """
    root = _Builder(groups, actions, recovery).root()
    hold_definition = Definition(HOLD, hold_body("{object}", "{position}", "{orientation}"), HOLD_PORTS)
    return _without_unused(Tree(Definition(tree_id, root), (hold_definition, *recovery.definitions)))


class _Builder:
    """Builds the root of one tree."""

    def __init__(self, groups: Sequence[Group], actions: Executables, recovery: Recovery) -> None:
        self.groups, self.actions, self.recovery = groups, actions, recovery

    def root(self) -> Node:
        first, alike = self.groups[0], len({group.held for group in self.groups}) == 1
        if len(self.groups) == 1:
            return sequence(*self._steps(first.steps, ()), *self._held(first))
        lists = [group.steps for group in self.groups]
        begin = _common(lists) if alike else 0
        end = _common([steps[begin:][::-1] for steps in lists]) if alike else 0
        middles = [steps[begin : len(steps) - end] for steps in lists]
        choice = self._choice(middles, first.steps[:begin])
        before, after = first.steps[:begin], first.steps[len(first.steps) - end :]
        nodes = [*self._steps(before, ()), *choice, *self._steps(after, before), *self._held(first)]
        return nodes[0] if len(nodes) == 1 else sequence(*nodes)

    def _choice(self, middles: Sequence[Sequence[Step]], done: Sequence[Step]) -> Sequence[Node]:
        """One of several ways: a finished one is left alone, else the first that does not fail is pursued.

        The Fallback over the ways has memory, so that one way is not given up for another while it runs. Ways of
        several steps after the first are pursued as long as the tree stays within eleven nodes a placement.
        """
        if all(len(middle) == 1 for middle in middles):
            return self._choice_of([middle[0] for middle in middles], done)
        tests = [self._test(middle) for middle in middles[1:]]
        ways = [sequence(*self._steps(middle, done)) for middle in middles]
        pursued = ways[:1]
        for way in ways[1:]:
            longer = fallback(*tests, fallback(*pursued, way, reactive=False))
            if self._nominal_size(longer) <= self._bound(middles):
                pursued.append(way)
        first = pursued[0] if len(pursued) == 1 else fallback(*pursued, reactive=False)
        return (fallback(*tests, first),)

    def _choice_of(self, steps: Sequence[Step], done: Sequence[Step]) -> Sequence[Node]:
        """One of several steps; guards that all share stand once, room for the first is made as `_steps` does it."""
        first, *others = steps
        tests = [self._condition(step) for step in steps]
        if first.guards and {step.guards for step in others} == {first.guards}:
            guards, known = self._steps(first.guards, done), (*done, *first.guards)
            chains = [sequence(*self._room(step, known), *self._placed(step)) for step in steps]
            return (fallback(*tests, sequence(*guards, fallback(*chains, reactive=False)), reactive=False),)
        room = () if first.guards else self._room(first, done, others)
        chain = self._chain(first, done) if first.guards else sequence(*self._placed(first))
        chains = [chain, *(self._chain(step, done) for step in others)]
        return (*room, fallback(*tests, *chains, reactive=False))

    def _bound(self, middles: Sequence[Sequence[Step]]) -> int:
        placements = {target for middle in middles for step in middle for target in step.targets()}
        return 11 * len(placements) + len(middles)

    def _nominal_size(self, node: Node) -> int:
        """The size of a node, Hold unfolded and recovery left out."""
        holding = hold_body("o", "p", "q").size
        unfolded = (holding if n.id == HOLD else 0 if is_recovery(n) else 1 for n in node.walk())
        return sum(unfolded)

    def _test(self, steps: Sequence[Step]) -> Node:
        conditions = [self._condition(step) for step in steps]
        return conditions[0] if len(conditions) == 1 else sequence(*conditions)

    def _held(self, group: Group) -> list[Node]:
        return [hold(group.held, self.actions)] if group.held else []

    def _steps(self, steps: Sequence[Step], done: Sequence[Step]) -> list[Node]:
        """Steps in a row; `done` are those that earlier siblings have just checked."""
        nodes: list[Node] = []
        for place, step in enumerate(steps):
            earlier = (*done, *steps[:place])
            nodes += [node for node in self.recovery.standing(step) if node not in nodes]
            nodes += () if step.guards else self._room(step, earlier)
            chain = self._chain(step, earlier) if step.guards else sequence(*self._placed(step))
            nodes.append(fallback(self._condition(step), chain, *self.recovery.otherwise(step), reactive=False))
        return nodes

    def _condition(self, step: Step) -> Node:
        return leaf(self._placement(step).achieves)

    def _chain(self, step: Step, done: Sequence[Step]) -> Node:
        """The guards, room made, the object in hand, and the placement."""
        guards = self._steps(step.guards, done)
        return sequence(*guards, *self._room(step, (*done, *step.guards)), *self._placed(step))

    def _room(self, step: Step, done: Sequence[Step], instead: Sequence[Step] = ()) -> Sequence[Node]:
        return self.recovery.before(step, [other.target for other in done], instead)

    def _placed(self, step: Step) -> tuple[Node, Node]:
        return hold(step.target.object, self.actions), leaf(self._placement(step))

    def _placement(self, step: Step) -> Place | Drop:
        return self.actions.placements[step.target]


def _common(lists: Sequence[Sequence[Step]]) -> int:
    """How many first steps all lists share."""
    return next((k for k, steps in enumerate(zip(*lists, strict=False)) if len(set(steps)) > 1), min(map(len, lists)))


def hold(name: str, actions: Executables) -> Node:
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
