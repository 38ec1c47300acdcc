"""The real BehaviorTree.CPP (behaviortreepy) as a judge: our trees loaded and ticked there.

behaviortreepy cannot declare the ports of a node, and BehaviorTree.CPP refuses attributes that are no declared ports.
So leaves are rewritten to nodes `BareCondition` and `BareAction` without attributes; everything else is ticked by C++
as it stands in the document. Which leaf a callback is for tells its UID: BehaviorTree.CPP numbers the nodes from 1 in
depth-first order, a SubTree before what it contains. What a leaf's port `{name}` refers to is looked up in the
blackboard that BehaviorTree.CPP built for that SubTree, and must be what the flattened tree says; what a query writes
is written there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree import ElementTree

import behaviortreepy

from learner.execution.entries import Entries
from learner.execution.ticking import Leaves, Status
from learner.model.tree import Node, Value
from learner.model.vocabulary import CONDITIONS, LEAVES, QUERIES, REFERENCE, SUBTREE, outputs_of
from storage.btcpp import written

TO_CPP = {
    Status.RUNNING: behaviortreepy.NodeStatus.RUNNING,
    Status.SUCCESS: behaviortreepy.NodeStatus.SUCCESS,
    Status.FAILURE: behaviortreepy.NodeStatus.FAILURE,
}
FROM_CPP = {cpp: ours for ours, cpp in TO_CPP.items()}


def leaves(root: Node) -> list[Node]:
    """The leaves of a flattened tree, depth first."""
    return [node for node in root.walk() if node.kind in LEAVES]


def document(root: Node) -> str:
    """A flattened tree as a document of BehaviorTree.CPP; the leaves' ports are left out."""
    top = ElementTree.Element("root", BTCPP_format="4", main_tree_to_execute="Main")
    _append(ElementTree.SubElement(top, "BehaviorTree", ID="Main"), root)
    return ElementTree.tostring(top, encoding="unicode")


def _append(parent: ElementTree.Element, node: Node) -> None:
    element = ElementTree.SubElement(parent, node.kind)
    for child in node.children:
        _append(element, child)


class CppTicker:
    """As learner.execution.ticking.Ticker, but ticked by BehaviorTree.CPP.

    `root` is the flattened tree: it says what the leaves mean. `xml` is the exported document that C++ loads,
    in compact form; without it, `root` is written out plainly.
    """

    def __init__(self, root: Node, world: Leaves, xml: str | None = None) -> None:
        top = ElementTree.fromstring(xml or document(root))
        trees = {str(tree.get("ID")): tree[0] for tree in top.iter("BehaviorTree")}
        elements = list(_expanded(trees[str(top.get("main_tree_to_execute"))], trees))
        found = {uid: element for uid, element in enumerate(elements, start=1) if element.tag in LEAVES}
        meant = leaves(root)
        assert [element.tag for element in found.values()] == [node.kind for node in meant]
        self._leaves = dict(zip(found, meant, strict=True))
        self._entries = Entries()
        self._bound = {uid: self._entries.bound(node) for uid, node in self._leaves.items()}
        self._ports = {uid: dict(element.attrib) for uid, element in found.items()}
        self._world = world
        self._running: dict[int, Node] = {}
        self._factory = behaviortreepy.BehaviorTreeFactory()
        self._factory.register_simple_condition("BareCondition", self._check)
        self._factory.register_simple_stateful_action(
            "BareAction", self._tick_action, self._tick_action, self._halt_action
        )
        self._tree = self._factory.create_tree_from_text(_without_ports(top))

    def tick(self) -> Status:
        """Tick the root exactly once."""
        return FROM_CPP[self._tree.tick_exactly_once()]

    def halt(self) -> None:
        """Halt the whole tree."""
        self._tree.halt_tree()

    def _check(self, cpp_node: behaviortreepy.TreeNode) -> behaviortreepy.NodeStatus:
        leaf, bound = self._leaves[cpp_node.uid()], self._leaf(cpp_node)
        if bound is None:
            return TO_CPP[Status.FAILURE]
        if leaf.kind in QUERIES:
            return self._find(cpp_node, leaf, bound)
        return TO_CPP[Status.SUCCESS if self._world.check(bound) else Status.FAILURE]

    def _find(self, cpp_node: behaviortreepy.TreeNode, leaf: Node, bound: Node) -> behaviortreepy.NodeStatus:
        found = self._world.find(bound)
        if found is None:
            return TO_CPP[Status.FAILURE]
        self._entries.write(leaf, found)
        for port in outputs_of(leaf.kind):
            reference = REFERENCE.fullmatch(self._ports[cpp_node.uid()][port])
            assert reference
            cpp_node.config().blackboard.set_string(reference[1], written(found[port]))
        return TO_CPP[Status.SUCCESS]

    def _tick_action(self, cpp_node: behaviortreepy.TreeNode) -> behaviortreepy.NodeStatus:
        uid = cpp_node.uid()
        bound = self._running.pop(uid, None) or self._leaf(cpp_node)
        if bound is None:
            return TO_CPP[Status.FAILURE]
        status = self._world.tick_action(bound)
        if status is Status.RUNNING:
            self._running[uid] = bound
        return TO_CPP[status]

    def _halt_action(self, cpp_node: behaviortreepy.TreeNode) -> None:
        self._world.halt_action(self._running.pop(cpp_node.uid()))

    def _leaf(self, cpp_node: behaviortreepy.TreeNode) -> Node | None:
        """The leaf as C++ sees its ports; None while it reads what nobody has written."""
        uid = cpp_node.uid()
        node = self._bound[uid]()
        if node is None:
            return None
        for name, text in self._ports[uid].items():
            if name in outputs_of(node.kind):
                continue
            reference = REFERENCE.fullmatch(text)
            seen = cpp_node.config().blackboard.get_string(reference[1]) if reference else text
            assert _same(seen, node.port(name)), f"{node.kind} {name}: C++ sees {seen!r}, we {node.port(name)!r}"
        return node


def _expanded(element: ElementTree.Element, trees: dict[str, ElementTree.Element]) -> Iterator[ElementTree.Element]:
    yield element
    if element.tag == SUBTREE:
        yield from _expanded(trees[element.attrib["ID"]], trees)
    for child in element:
        yield from _expanded(child, trees)


def _without_ports(top: ElementTree.Element) -> str:
    """The document with bare leaves (changed in place) and without the models of nodes that have ports."""
    for model in top.findall("TreeNodesModel"):
        top.remove(model)
    for element in [element for element in top.iter() if element.tag in LEAVES]:
        element.tag = "BareCondition" if element.tag in CONDITIONS else "BareAction"
        element.attrib.clear()
    return ElementTree.tostring(top, encoding="unicode")


def _same(text: str, value: Value) -> bool:
    if isinstance(value, str):
        return text == value
    numbers = value if isinstance(value, tuple) else (value,)
    return all(math.isclose(float(a), b) for a, b in zip(text.split(";"), numbers, strict=True))
