"""The tree of our method: what backchaining unfolds to, with each condition checked once (paper, section III-C).

A target becomes Fallback(condition, Sequence(guards, hold the object, place it)) and holding an object
Fallback(InGripper, Sequence(Fallback(GripperIs open, SetGripper open), Pick)): 11 nodes a target. Goals stand in a
reactive Sequence in an order in which each is reached without undoing those before it, so that what an earlier one
has established is not checked again; that the gripper is free at the end follows, since a placed object is one that
is not held.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from learner.executables import Executables
from learner.groups import Group, Step
from learner.model import Definition, GripperIs, InGripper, Node, SetGripper, Tree
from learner.model.tree import Value, fallback, leaf, sequence, subtree
from learner.recovery import Recovery

HOLD = "Hold"
HOLD_PORTS = ("object", "orientation", "position")

Before = Callable[[Step], Sequence[Node]]
"""What recovery puts before a step's object is taken in hand; nothing where it knows nothing."""


def tree_of(main_id: str, groups: Sequence[Group], actions: Executables, recovery: Recovery) -> Tree:
    """The tree of all groups: any finished goal is left alone, else the first group's is pursued.

    The goals of the further groups are tested before any is pursued; a further group's own tree follows the first
    under a Fallback with memory as long as the whole stays within eleven nodes a placement.
    """
    roots = [_root(group, actions, recovery.before) for group in groups]
    hold_definition = Definition(HOLD, hold_body("{object}", "{position}", "{orientation}"), HOLD_PORTS)
    definitions = [hold_definition, *recovery.definitions]
    tree = Tree(Definition(main_id, _together(groups, roots, actions, definitions)), tuple(definitions))
    return _without_unused(tree)


def _together(
    groups: Sequence[Group], roots: Sequence[Node], actions: Executables, definitions: Sequence[Definition]
) -> Node:
    if len(roots) == 1:
        return roots[0]
    tests = [_test(group, actions) for group in groups[1:]]
    placements = {target for group in groups for step in group.steps for target in step.targets()}
    bound = 11 * len(placements) + len(groups) + 1
    pursued: list[Node] = [roots[0]]
    for root in roots[1:]:
        longer = [*pursued, root]
        if _size(fallback(*tests, fallback(*longer, reactive=False)), definitions) <= bound:
            pursued = longer
    first = pursued[0] if len(pursued) == 1 else fallback(*pursued, reactive=False)
    return fallback(*tests, first)


def _size(root: Node, definitions: Sequence[Definition]) -> int:
    return Tree(Definition("size", root), tuple(definitions)).nodes


def _test(group: Group, actions: Executables) -> Node:
    conditions = [leaf(actions.placements[step.target].achieves) for step in group.steps]
    if group.held:
        conditions.append(leaf(InGripper(group.held)))
    return conditions[0] if len(conditions) == 1 else sequence(*conditions)


def _root(group: Group, actions: Executables, before: Before) -> Node:
    steps = [step_node(step, actions, before) for step in group.steps]
    return sequence(*steps, *([hold(group.held, actions)] if group.held else []))


def step_node(step: Step, actions: Executables, before: Before) -> Node:
    """The node that reaches one target and keeps its guards meanwhile."""
    placement = actions.placements[step.target]
    chain = [step_node(guard, actions, before) for guard in step.guards]
    held = hold(step.target.object, actions)
    return fallback(leaf(placement.achieves), sequence(*chain, *before(step), held, leaf(placement)))


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
