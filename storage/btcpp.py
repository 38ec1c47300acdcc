"""Trees in the XML of BehaviorTree.CPP 4: writer, reader and validator (CONTRACT, section 3).

`from_xml(to_xml(tree)) == tree`, and equal trees have equal bytes. The reader takes nothing that the contract refuses,
so reading a text is validating it. References to ports of a SubTree stay references; their type follows from the leaf
at which they end.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence, Set
from typing import Final

from learner.errors import LearnerError
from learner.model.frame import check_frame
from learner.model.names import NODES, NONE, check_name, identifier
from learner.model.query import sites_of
from learner.model.tree import IDENTIFIER, MAX_DEPTH, Definition, Node, Tree, Value, is_reference
from learner.model.vocabulary import (
    ACTIONS,
    CONDITIONS,
    DECORATORS,
    FALLBACKS,
    LEAVES,
    LENGTHS,
    REFERENCE,
    SCALARS,
    SECOND,
    SEQUENCES,
    SUBTREE,
    outputs_of,
    port_kind,
)
from storage.errors import WrittenTreeError

VERSION: Final = "4"
KINDS: Final = (*LEAVES, *SEQUENCES, *FALLBACKS, *DECORATORS, SUBTREE)
EXPLICIT: Final = ("Action", "Condition", "Control", "Decorator")
PORT_DOCUMENTATION: Final = {
    "state": "open or closed",
    "object": "object id",
    "frame": "object id or base frame",
    "position": "x;y;z in metres in frame",
    "orientation": "quaternion x;y;z;w in frame",
    "radius": "metres",
    "angle": "radians",
    "found": "object id",
    "kind": "kind of the scene",
    "at": "places frame;x;y;z;radius, ;rough behind a cylinder, joined by |",
    "not_at": "places, as in at",
    "count": "at least so many",
    "signal": "name of a signal",
    "value": "JSON",
}
MAX_NODES: Final = 300_000
"""Far beyond any learned tree; SubTrees of SubTrees can multiply without bound."""
RESERVED_PORTS: Final = ("name", "ID")
INSTANCE_NAME: Final = re.compile(r"[A-Za-z0-9_]+", re.ASCII)

Roots = Mapping[str, ET.Element]
PortKinds = Mapping[tuple[str, str], str]
Ports = Mapping[str, Set[str]]
"""Names of ports or entries, by the ID of a tree."""


def to_xml(tree: Tree) -> str:
    """The text of `tree`: compact form, two spaces of indentation, a TreeNodesModel of the vocabulary's nodes.

    SubTrees are named after what they do, no two alike within one definition. Raises WrittenTreeError for a tree that
    BehaviorTree.CPP 4.10 or the contract would refuse.
    """
    root = ET.Element("root", {"BTCPP_format": VERSION, "main_tree_to_execute": tree.main.id})
    for definition in (tree.main, *tree.subtrees):
        behavior = ET.SubElement(root, "BehaviorTree", {"ID": definition.id})
        behavior.append(_element(definition.root, set()))
    root.append(_model(tree))
    ET.indent(root)
    text = '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
    if from_xml(text) != tree:
        raise WrittenTreeError(f"the tree {tree.main.id} has a port that no leaf uses; leave it out")
    return text


def from_xml(text: str | bytes) -> Tree:
    """The tree of a text. Raises WrittenTreeError for whatever `validate` refuses."""
    root = _parse(text)
    roots = _roots(root)
    main = root.get("main_tree_to_execute")
    if main not in roots:
        raise WrittenTreeError(f"main_tree_to_execute is {main!r}; the trees are {', '.join(roots)}")
    for tree_id, element in roots.items():
        _check_form(tree_id, element, roots)
    _check_extent(roots)
    kinds = _port_kinds(roots)
    _check_models(root, roots)
    names = _handed(roots), _written_entries(roots)
    definitions = {tree_id: _definition(tree_id, element, roots, kinds, *names) for tree_id, element in roots.items()}
    if definitions[str(main)].ports:
        raise WrittenTreeError(f"the main tree {main} refers to {{{definitions[str(main)].ports[0]}}} but has no ports")
    try:
        tree = Tree(definitions.pop(str(main)), tuple(definitions.values()))
        _check_values(tree)
    except LearnerError as error:
        raise WrittenTreeError(str(error)) from error
    return tree


def validate(xml: str | bytes) -> None:
    """Refuse, with a WrittenTreeError that names the place, a text that is no tree of the contract, section 3.

    Checked: format and main tree; the vocabulary; compact form; every port against the leaf's definition and the
    TreeNodesModel; port references; no script or condition attributes, no `_autoremap`; and what
    BehaviorTree.CPP 4.10 refuses although 4.8 does not: characters of names, twin siblings, depth.
    """
    from_xml(xml)


def _element(node: Node, taken: set[str]) -> ET.Element:
    ports = dict(node.ports)
    order = LEAVES.get(node.kind, tuple(sorted(ports)))
    texts = {name: written(ports[name]) for name in order}
    head = {"ID": str(node.id), "name": _instance_name(node, taken)} if node.kind == SUBTREE else {}
    element = ET.Element(node.kind, {**head, **texts})
    element.extend(_element(child, taken) for child in node.children)
    return element


def _instance_name(node: Node, taken: set[str]) -> str:
    ports = sorted(node.ports, key=lambda port: (port[0] != "object", port[0]))
    values = [value for _, value in ports if isinstance(value, str) and not REFERENCE.fullmatch(value)]
    words = [str(node.id), *dict.fromkeys(values)]
    stem = identifier("_".join(words))
    name, count = stem, 1
    while name in taken:
        count += 1
        name = f"{stem}_{count}"
    taken.add(name)
    return name


def written(value: Value) -> str:
    """The text of a port's value: numbers joined by `;`. Raises WrittenTreeError for what is not finite."""
    if isinstance(value, str):
        return value
    numbers = [float(number) for number in (value if isinstance(value, tuple) else (value,))]
    if not all(map(math.isfinite, numbers)):
        raise WrittenTreeError(f"the value {value} is not finite, so it cannot be written")
    return ";".join(map(repr, numbers))


def _model(tree: Tree) -> ET.Element:
    """Of every node of vocabulary 1, and of those of vocabulary 2 that the tree has."""
    model = ET.Element("TreeNodesModel")
    for tag, leaves in (("Condition", CONDITIONS), ("Action", ACTIONS)):
        for kind, ports in leaves.items():
            if kind in SECOND and kind not in tree.leaves:
                continue
            entry = ET.SubElement(model, tag, {"ID": kind})
            for port in ports:
                direction = "output_port" if port in outputs_of(kind) else "input_port"
                ET.SubElement(entry, direction, {"name": port}).text = PORT_DOCUMENTATION[port]
    return model


def _parse(text: str | bytes) -> ET.Element:
    if b"<!DOCTYPE" in (text.encode() if isinstance(text, str) else text):
        raise WrittenTreeError("a tree has no document type; remove <!DOCTYPE>")
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise WrittenTreeError(f"this is not XML: {error}") from error
    if root.tag != "root" or root.get("BTCPP_format") != VERSION:
        raise WrittenTreeError('a tree of BehaviorTree.CPP 4 begins with <root BTCPP_format="4" ...>')
    for child in root:
        if child.tag not in ("BehaviorTree", "TreeNodesModel"):
            raise WrittenTreeError(f"<{child.tag}> does not belong below <root>")
    return root


def _roots(root: ET.Element) -> dict[str, ET.Element]:
    roots: dict[str, ET.Element] = {}
    for behavior in root.iterfind("BehaviorTree"):
        tree_id = behavior.get("ID", "")
        if tree_id in NODES:
            raise WrittenTreeError(f"a BehaviorTree cannot have the ID {tree_id}, which is the name of a node")
        if not IDENTIFIER.fullmatch(tree_id):
            raise WrittenTreeError(f"a BehaviorTree cannot have the ID {tree_id!r}; use letters, digits and '_'")
        if tree_id in roots:
            raise WrittenTreeError(f"two BehaviorTrees have the ID {tree_id}")
        if len(behavior) != 1:
            raise WrittenTreeError(f"the BehaviorTree {tree_id} has {len(behavior)} roots, not one")
        roots[tree_id] = behavior[0]
    return roots


def _check_form(tree_id: str, root: ET.Element, roots: Roots) -> None:
    for element in root.iter():
        if element.tag not in KINDS:
            form = "write it in compact form" if element.tag in EXPLICIT else "it is no node of the contract"
            raise WrittenTreeError(f"<{element.tag}> in {tree_id}: {form}")
        if element.tag == SUBTREE and element.get("ID") not in roots:
            raise WrittenTreeError(f"{tree_id} uses the SubTree {element.get('ID')!r}; defined are {', '.join(roots)}")
        _check_attributes(tree_id, element)
        _check_twins(tree_id, element)


def _check_attributes(tree_id: str, element: ET.Element) -> None:
    for attribute, value in element.attrib.items():
        if attribute.startswith("_"):
            raise WrittenTreeError(f"{element.tag} in {tree_id} has the attribute {attribute}, which is refused")
        if attribute == "name" and not INSTANCE_NAME.fullmatch(value):
            raise WrittenTreeError(f"{element.tag} in {tree_id} is named {value!r}; use letters, digits and '_'")
        if "{" in value and not REFERENCE.fullmatch(value):
            raise WrittenTreeError(f"{element.tag} in {tree_id} has {attribute} = {value!r}, no reference to a port")


def _check_twins(tree_id: str, element: ET.Element) -> None:
    names = [child.get("name", child.get("ID")) for child in element if child.tag == SUBTREE]
    twins = {name for name in names if names.count(name) > 1}
    if twins:
        raise WrittenTreeError(f"two SubTrees beside each other in {tree_id} are named {min(map(str, twins))}")


def _check_models(root: ET.Element, roots: Roots) -> None:
    models = root.findall("TreeNodesModel")
    if len(models) != 1:
        raise WrittenTreeError(f"a tree has one TreeNodesModel, not {len(models)}")
    listed = {entry.get("ID", ""): entry for entry in models[0] if entry.tag != SUBTREE}
    for kind, entry in listed.items():
        _check_model(kind, entry)
    used = {element.tag for tree_root in roots.values() for element in tree_root.iter()} & set(LEAVES)
    if missing := sorted(used - set(listed)):
        raise WrittenTreeError(f"the TreeNodesModel does not list {', '.join(missing)}")


def _check_model(kind: str, entry: ET.Element) -> None:
    if kind not in LEAVES:
        raise WrittenTreeError(f"the TreeNodesModel lists {kind!r}, which is no node of the contract")
    tag = "Condition" if kind in CONDITIONS else "Action"
    found = sorted((port.tag, port.get("name", "")) for port in entry)
    outputs = outputs_of(kind)
    inputs = [port for port in LEAVES[kind] if port not in outputs]
    if entry.tag != tag or found != sorted([*_directed("input_port", inputs), *_directed("output_port", outputs)]):
        written = f" and outputs {', '.join(outputs)}" if outputs else ""
        raise WrittenTreeError(
            f"the TreeNodesModel must list {kind} as <{tag}> with inputs {', '.join(inputs) or 'none'}{written}"
        )


def _directed(direction: str, ports: Sequence[str]) -> list[tuple[str, str]]:
    return [(direction, port) for port in ports]


def _references(root: ET.Element) -> Iterator[tuple[ET.Element, str, str]]:
    """Each (element, attribute, port of the SubTree that it refers to)."""
    for element in root.iter():
        for attribute, value in element.attrib.items():
            if reference := REFERENCE.fullmatch(value):
                yield element, attribute, reference[1]


def _port_kinds(roots: Roots) -> dict[tuple[str, str], str]:
    """For each (tree, port) the kind of leaf port at which it ends; passes on until nothing new is found."""
    kinds: dict[tuple[str, str], str] = {}
    before = -1
    while before != len(kinds):
        before = len(kinds)
        for tree_id, root in roots.items():
            for element, attribute, port in _references(root):
                if kind := _attribute_kind(element, attribute, kinds):
                    _agree(kinds, tree_id, port, kind)
    return kinds


def _attribute_kind(element: ET.Element, attribute: str, kinds: PortKinds) -> str | None:
    if element.tag == SUBTREE:
        return kinds.get((element.get("ID", ""), attribute))
    return port_kind(attribute)


def _agree(kinds: dict[tuple[str, str], str], tree_id: str, port: str, kind: str) -> None:
    if kinds.setdefault((tree_id, port), kind) != kind:
        raise WrittenTreeError(f"the port {port} of {tree_id} is used both as {kinds[tree_id, port]} and as {kind}")


def _handed(roots: Roots) -> Ports:
    """For each tree the ports that its uses hand in."""
    handed: dict[str, set[str]] = {tree_id: set() for tree_id in roots}
    for root in roots.values():
        for element in root.iter(SUBTREE):
            handed[element.get("ID", "")] |= element.attrib.keys() - {"ID", "name"}
    return handed


def _written_entries(roots: Roots) -> Ports:
    """For each tree the names that its leaves write, or the SubTrees that it uses; until nothing new is found."""
    written: dict[str, set[str]] = {tree_id: set() for tree_id in roots}
    before = -1
    while before != (before := sum(map(len, written.values()))):
        for tree_id, root in roots.items():
            for element, attribute, name in _references(root):
                inside = written[element.get("ID", "")] if element.tag == SUBTREE else outputs_of(element.tag)
                if attribute in inside:
                    written[tree_id] |= {name}
    return written


def _definition(
    tree_id: str, root: ET.Element, roots: Roots, kinds: PortKinds, handed: Ports, written: Ports
) -> Definition:
    references = {port for _, _, port in _references(root)}
    ports = {port for port in references if port in handed[tree_id] or port not in written[tree_id]}
    for port in references:
        if not IDENTIFIER.fullmatch(port) or port.startswith("_") or port in RESERVED_PORTS:
            raise WrittenTreeError(f"a port of {tree_id} cannot be called {port!r}")
    return Definition(tree_id, _node(root, kinds), tuple(sorted(ports)))


def _node(element: ET.Element, kinds: PortKinds) -> Node:
    tree_id = element.get("ID") if element.tag == SUBTREE else None
    written = {
        name: value for name, value in element.attrib.items() if name != "name" and not (name == "ID" and tree_id)
    }
    ports = tuple(sorted((name, _value(element, name, text, kinds)) for name, text in written.items()))
    return Node(element.tag, ports, tuple(_node(child, kinds) for child in element), tree_id)


def _value(element: ET.Element, port: str, text: str, kinds: PortKinds) -> Value:
    kind = _attribute_kind(element, port, kinds)
    if REFERENCE.fullmatch(text) or kind not in (*LENGTHS, *SCALARS):
        return text
    numbers = _numbers(element, port, text)
    if len(numbers) != LENGTHS.get(kind, 1):
        raise WrittenTreeError(f"{element.tag} has {port} = {text!r}, which are {len(numbers)} numbers")
    return numbers[0] if kind in SCALARS else numbers


def _numbers(element: ET.Element, port: str, text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(";"))
    except ValueError:
        numbers = ()
    if not numbers or not all(map(math.isfinite, numbers)):
        raise WrittenTreeError(f"{element.tag} has {port} = {text!r}; numbers are finite and joined by ';'")
    return numbers


def _check_values(tree: Tree) -> None:
    """What only shows once the ports of the SubTrees are filled in."""
    for node in tree.flattened().walk():
        for port, value in node.ports:
            if is_reference(value):
                continue
            if port == "frame":
                check_frame(str(value))
            if port in ("kind", "signal"):
                check_name(port, value)
            if port in ("at", "not_at"):
                for site in sites_of(str(value)):
                    check_frame(site.frame)
            if port == "object" and not (node.kind == "InGripper" and value == NONE):
                check_name(port, value)
            if port == "state" and value not in ("open", "closed"):
                raise WrittenTreeError(f"{node.kind} has state = {value!r}; a gripper is open or closed")
            if port in SCALARS and not (isinstance(value, float) and value > 0):
                raise WrittenTreeError(f"{node.kind} has {port} = {value!r}; it is above 0")


def _check_extent(roots: Roots) -> None:
    """Depth and size with every SubTree filled in, before anything recurses into it; a SubTree counts as a level."""
    extents: dict[str, tuple[int, int]] = {}
    for tree_id in roots:
        depth, size = _extent(tree_id, roots, extents, ())
        if depth >= MAX_DEPTH:
            raise WrittenTreeError(f"{tree_id} nests {depth} levels deep; BehaviorTree.CPP takes {MAX_DEPTH - 1}")
        if size > MAX_NODES:
            raise WrittenTreeError(f"{tree_id} has {size} nodes with its SubTrees filled in; at most {MAX_NODES}")


def _extent(tree_id: str, roots: Roots, extents: dict[str, tuple[int, int]], above: tuple[str, ...]) -> tuple[int, int]:
    if tree_id in above:
        raise WrittenTreeError(f"the SubTree {tree_id} contains itself")
    if tree_id not in extents:
        deepest, size = 0, 0
        for element, level in _levels(roots[tree_id]):
            inner = (0, 0)
            if element.tag == SUBTREE:
                inner = _extent(element.get("ID", ""), roots, extents, (*above, tree_id))
            deepest, size = max(deepest, level + inner[0]), size + 1 + inner[1]
        extents[tree_id] = deepest, size
    return extents[tree_id]


def _levels(root: ET.Element) -> Iterator[tuple[ET.Element, int]]:
    """Every element with its level, the root's being 1; without recursion, for a text may nest as deep as it likes."""
    waiting = [(root, 1)]
    while waiting:
        element, level = waiting.pop()
        yield element, level
        waiting.extend((child, level + 1) for child in element)
