"""Behavior trees as plain data, with canonical JSON and a digest (CONTRACT, section 3).

A `Tree` is a main definition and the SubTrees that it uses. Every node has a `kind`, `ports` and `children`; a leaf's
ports are values, or, inside a SubTree, references `{port}` to the ports of that SubTree.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any, Final, cast

from learner.errors import ModelError, TreeError
from learner.model.action import Action, Drop, Motion, Pick, Place, SetGripper
from learner.model.condition import Condition, GripperIs, InGripper, ObjectAt, ObjectPosedAt, ObjectRoughlyAt
from learner.model.frame import is_composed
from learner.model.names import NONE
from learner.model.pose import Pose
from learner.model.query import (
    CountAt,
    FindGrasp,
    FindHeld,
    FindInTheWay,
    FindObject,
    FindSpot,
    FindUnder,
    FindUpon,
    Query,
    SetSignal,
    SignalIs,
    signal_of,
    sites_of,
)
from learner.model.vocabulary import (
    DECORATORS,
    ENTRY,
    FALLBACKS,
    LEAVES,
    LENGTHS,
    RECOVERY_PREFIX,
    REFERENCE,
    SCALARS,
    SECOND,
    SEQUENCES,
    SUBTREE,
    outputs_of,
    port_kind,
)

Value = str | float | tuple[float, ...]
Word = Condition | SignalIs | CountAt | Query | Motion | SetGripper | SetSignal
"""What a leaf of a flattened tree says."""

FORMAT: Final = "treewright.tree/1"
IDENTIFIER: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
MAX_DEPTH: Final = 250
"""BehaviorTree.CPP 4.10 refuses deeper nesting (CONTRACT, section 3: below 250)."""


@dataclass(frozen=True)
class Node:
    """A node: its `kind` in the contract's vocabulary, sorted `ports`, and `children`. A SubTree has its `id`."""

    kind: str
    ports: tuple[tuple[str, Value], ...] = ()
    children: tuple[Node, ...] = ()
    id: str | None = None

    def port(self, name: str) -> Value:
        """The value of a port. Raises KeyError if there is none."""
        return dict(self.ports)[name]

    @cached_property
    def word(self) -> Word:
        """What a leaf says, decoded once.

        Raises TreeError for a node that is no leaf, or that refers to the ports of its SubTree.
        """
        return _word_of(self)

    def walk(self) -> Iterator[Node]:
        """This node and all below it, depth first, left to right."""
        left = [self]
        while left:
            node = left.pop()
            yield node
            left.extend(reversed(node.children))

    @property
    def size(self) -> int:
        """The number of nodes from here down."""
        return sum(1 for _ in self.walk())

    @property
    def depth(self) -> int:
        """The number of levels from here down."""
        return 1 + max((child.depth for child in self.children), default=0)


def _word_of(node: Node) -> Word:
    ports: dict[str, Any] = {name: value for name, value in node.ports if name not in outputs_of(node.kind)}
    if node.kind not in LEAVES:
        raise TreeError(f"{node.kind} is no leaf")
    if any(is_reference(value) for value in ports.values()):
        raise TreeError(f"{node.kind} refers to the ports of its SubTree: flatten the tree first")
    if node.kind in MOTIONS:
        pose = Pose(ports["position"], ports["orientation"])
        return Motion(cast(Any, node.kind), ports["object"], ports["frame"], pose)
    read = {name: _READ.get(name, _as_it_is)(value) for name, value in ports.items()}
    try:
        return _WORDS[node.kind](**read)
    except ModelError as error:
        raise TreeError(f"{node.kind}: {error}") from error


def _as_it_is(value: Value) -> Value:
    return value


MOTIONS: Final = ("Pick", "Place", "Drop")
_READ: Final[Mapping[str, Callable[[Any], Any]]] = {"at": sites_of, "not_at": sites_of, "count": int}
"""How the text of a port becomes a value of its word, where it is not taken as it is."""
_WORDS: Final[Mapping[str, Callable[..., Word]]] = {
    kind.__name__: kind
    for kind in (
        GripperIs, InGripper, ObjectAt, ObjectPosedAt, ObjectRoughlyAt, SetGripper, SignalIs, SetSignal, CountAt,
        FindObject, FindUpon, FindUnder, FindInTheWay, FindHeld, FindSpot, FindGrasp,
    )
}  # fmt: skip


def is_reference(value: Value) -> bool:
    """Whether a port's value refers to a port or an entry, of a SubTree or of a flattened tree."""
    return isinstance(value, str) and bool(REFERENCE.fullmatch(value) or ENTRY.fullmatch(value))


def leaf(word: Condition | Action) -> Node:
    """The leaf of a condition or an action: its ports are exactly those of the contract."""
    match word:
        case GripperIs() | SetGripper():
            values: dict[str, Value] = {"state": word.state}
        case InGripper():
            values = {"object": word.object}
        case ObjectAt() | ObjectRoughlyAt():
            values = {
                "object": word.object,
                "frame": word.frame,
                "position": word.position,
                "radius": word.radius,
            }
            if isinstance(word, ObjectPosedAt):
                values |= {"orientation": word.orientation, "angle": word.angle}
        case Pick() | Place() | Drop():
            values = {
                "object": word.object,
                "frame": word.frame,
                "position": word.position,
                "orientation": word.orientation,
            }
    return Node(type(word).__name__, tuple(sorted(values.items())))


def asked(kind: str, /, **ports: Value) -> Node:
    """A leaf of vocabulary 2 by its ports, output ports included: references, or values as they are written."""
    return Node(kind, tuple(sorted(ports.items())))


def sequence(*children: Node, reactive: bool = True) -> Node:
    """A (Reactive)Sequence."""
    return Node("ReactiveSequence" if reactive else "Sequence", (), children)


def fallback(*children: Node, reactive: bool = True) -> Node:
    """A (Reactive)Fallback."""
    return Node("ReactiveFallback" if reactive else "Fallback", (), children)


def negated(node: Node) -> Node:
    """Success and failure change places."""
    return Node("Inverter", (), (node,))


def guarded(condition: Condition, action: Node) -> Node:
    """The action if the condition holds; with memory, so that the action may end what it was begun for."""
    return sequence(leaf(condition), action, reactive=False)


def first_of(nodes: Sequence[Node]) -> Node:
    """The first that does not fail; with memory, so that what runs is not given up for an earlier one."""
    return nodes[0] if len(nodes) == 1 else fallback(*nodes, reactive=False)


def subtree(tree_id: str, **ports: Value) -> Node:
    """A use of the SubTree `tree_id` with its ports filled in."""
    return Node(SUBTREE, tuple(sorted(ports.items())), (), tree_id)


@dataclass(frozen=True)
class Definition:
    """A named tree with the ports that its leaves may refer to, sorted: their order has no meaning."""

    id: str
    root: Node
    ports: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "ports", tuple(sorted(self.ports)))


@dataclass(frozen=True)
class Tree:
    """A main definition and the SubTrees that it uses, sorted by ID.

    Raises TreeError at construction for anything that the contract's vocabulary does not know.
    """

    main: Definition
    subtrees: tuple[Definition, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "subtrees", tuple(sorted(self.subtrees, key=lambda definition: definition.id)))
        _check(self)

    @property
    def definitions(self) -> Mapping[str, Definition]:
        return {definition.id: definition for definition in (self.main, *self.subtrees)}

    def flattened(self, recovery: bool = True) -> Node:
        """The root with every SubTree replaced by its own root, ports filled in.

        Without `recovery`, the SubTrees that only recover (CONTRACT, section 3) are left out.
        """
        return self._whole if recovery else self._nominal

    @cached_property
    def _whole(self) -> Node:
        return _Flattening(self.definitions, recovery=True).root(self.main)

    @cached_property
    def _nominal(self) -> Node:
        return _Flattening(self.definitions, recovery=False).root(self.main)

    @property
    def nodes(self) -> int:
        """The size of the flattened tree without what only recovers."""
        return self.flattened(recovery=False).size

    @property
    def nodes_recovery(self) -> int:
        """How many nodes of the flattened tree only recover from what was not demonstrated."""
        return self.flattened().size - self.nodes

    @property
    def nodes_written(self) -> int:
        """How many nodes the written file has, a SubTree's own nodes counted once."""
        return sum(definition.root.size for definition in self.definitions.values())

    def objects(self) -> frozenset[str]:
        """Every object that a leaf names, `none` left out."""
        return self._named("object") - {NONE}

    def frames(self) -> frozenset[str]:
        """Every frame that a leaf names."""
        sites = [*self._named("at"), *self._named("not_at")]
        return self._named("frame") | {site.frame for text in sites for site in sites_of(text)}

    def kinds(self) -> frozenset[str]:
        """Every kind of objects that a leaf names."""
        return self._named("kind")

    def signals(self) -> frozenset[str]:
        """Every signal that a leaf names."""
        return self._named("signal")

    @property
    def leaves(self) -> frozenset[str]:
        """The kinds of leaves that the tree has."""
        written = (node.kind for definition in self.definitions.values() for node in definition.root.walk())
        return frozenset(written) & LEAVES.keys()

    @property
    def vocabulary(self) -> int:
        """The least vocabulary of CONTRACT, section 3, that a world must know to run this tree."""
        return 2 if self.leaves & SECOND or any(is_composed(frame) for frame in self.frames()) else 1

    def _named(self, port: str) -> frozenset[str]:
        values = (value for node in self.flattened().walk() for name, value in node.ports if name == port)
        return frozenset(str(value) for value in values if not is_reference(value))

    def to_json(self) -> str:
        """Canonical JSON: keys sorted, no spaces, numbers as Python's shortest form. Equal trees, equal bytes."""
        document = {
            "format": FORMAT,
            "main": self.main.id,
            "trees": {key: _definition_to_data(value) for key, value in self.definitions.items()},
        }
        return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)

    @staticmethod
    def from_json(text: str | bytes) -> Tree:
        """The tree of `to_json`. Raises TreeError for anything else."""
        try:
            document = json.loads(text)
            if document["format"] != FORMAT:
                raise TreeError(f"this is a tree of format {document['format']!r}, not {FORMAT!r}")
            trees = {key: _definition_from_data(key, value) for key, value in document["trees"].items()}
            return Tree(trees.pop(document["main"]), tuple(trees.values()))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise TreeError(f"this is not a tree in JSON: {error}") from error

    @property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON, in hexadecimal."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()


class _Flattening:
    """Puts the root of each SubTree in the place of its uses, numbered, so that entries of each use are its own."""

    def __init__(self, definitions: Mapping[str, Definition], recovery: bool) -> None:
        self.definitions, self.recovery, self.uses = definitions, recovery, count()

    def root(self, definition: Definition, values: Mapping[str, Value] | None = None) -> Node:
        """The root of one use of a definition, its ports filled in with `values`."""
        return self._node(definition.root, values or {}, next(self.uses))

    def _node(self, node: Node, values: Mapping[str, Value], use: int) -> Node:
        ports = tuple((name, _resolve(value, values, use)) for name, value in node.ports)
        if node.kind == SUBTREE:
            return self.root(self.definitions[str(node.id)], dict(ports))
        kept = [child for child in node.children if self.recovery or not is_recovery(child)]
        return Node(node.kind, ports, tuple(self._node(child, values, use) for child in kept))


def is_recovery(node: Node) -> bool:
    """Whether the node stands only for recovery from what was not demonstrated."""
    return node.kind == SUBTREE and str(node.id).startswith(RECOVERY_PREFIX)


def _resolve(value: Value, values: Mapping[str, Value], use: int) -> Value:
    reference = REFERENCE.fullmatch(value) if isinstance(value, str) else None
    if not reference:
        return value
    return values.get(reference[1], f"{{{reference[1]}.{use}}}")


def _check(tree: Tree) -> None:
    if len(tree.definitions) != 1 + len(tree.subtrees):
        raise TreeError("two SubTrees have one ID")
    for definition in tree.definitions.values():
        if not IDENTIFIER.fullmatch(definition.id):
            raise TreeError(f"a tree's ID has letters, digits and '_' only, not {definition.id!r}")
        for node in definition.root.walk():
            _check_node(node, definition, tree.definitions)
    _check_cycles(tree.main, tree.definitions, ())
    flat = tree.flattened()
    _check_entries(flat)
    depth = flat.depth
    if depth >= MAX_DEPTH:
        raise TreeError(f"the tree {tree.main.id} nests {depth} levels deep; BehaviorTree.CPP admits {MAX_DEPTH - 1}")


def _check_node(node: Node, definition: Definition, definitions: Mapping[str, Definition]) -> None:
    ports, wanted = [name for name, _ in node.ports], _ports_of(node, definitions)
    if sorted(ports) != sorted(wanted):
        raise TreeError(f"{node.kind} {node.id or ''} in {definition.id} has the ports {ports}, not {list(wanted)}")
    for name, value in node.ports:
        if not is_reference(value):
            _check_value(node, name, value)
    children = len(node.children)
    if node.kind in LEAVES or node.kind == SUBTREE:
        fits = children == 0
    else:
        fits = children == 1 if node.kind in DECORATORS else children >= 1
    if not fits:
        raise TreeError(f"{node.kind} in {definition.id} cannot have {children} children")


def _check_entries(flat: Node) -> None:
    """Every entry is written by an earlier leaf than those that read it, and holds one kind of value."""
    kinds: dict[Value, str] = {}
    for node in flat.walk():
        for name, value in node.ports:  # what came through the port of a SubTree was not seen before
            if name in outputs_of(node.kind):
                continue
            if not is_reference(value):
                _check_value(node, name, value)
            elif kinds.get(value) != port_kind(name):
                raise TreeError(f"{node.kind} has {name} = {_shown(value)}, {_instead(kinds.get(value))}")
        for name in outputs_of(node.kind):
            value = node.port(name)
            if not is_reference(value):
                raise TreeError(f"{node.kind} writes its {name}, which cannot be {value!r}")
            if kinds.setdefault(value, port_kind(name)) != port_kind(name):
                raise TreeError(f"{node.kind} writes a {port_kind(name)} to {_shown(value)}, a {kinds[value]}")


def _shown(value: Value) -> str:
    return re.sub(r"\.[0-9]+}", "}", str(value))


def _instead(kind: str | None) -> str:
    return "which is no port and was not written before" if kind is None else f"which is a {kind}"


def _check_value(node: Node, name: str, value: Value) -> None:
    if name in LENGTHS:
        fits = isinstance(value, tuple) and len(value) == LENGTHS[name] and all(map(math.isfinite, value))
    elif name in SCALARS:
        fits = isinstance(value, float) and 0 < value < math.inf
    elif name in TEXTS and node.kind in LEAVES:
        fits = isinstance(value, str) and _is_read(TEXTS[name], value)
    elif name == "state":
        fits = value in ("open", "closed")
    else:
        fits = isinstance(value, str) or node.kind == SUBTREE
    if not fits:
        raise TreeError(f"{node.kind} cannot have {name} = {value!r}")


def _is_read(read: Callable[[str], Any], text: str) -> bool:
    try:
        read(text)
    except ModelError:
        return False
    return True


def _count_of(text: str) -> int:
    if not (text.isascii() and text.isdigit()):
        raise ModelError(f"a count is a whole number, not {text!r}")
    return int(text)


TEXTS: Final[Mapping[str, Callable[[str], Any]]] = {
    "at": sites_of,
    "not_at": sites_of,
    "count": _count_of,
    "value": signal_of,
}
"""Ports that hold text with a form, and what reads it."""


def _ports_of(node: Node, definitions: Mapping[str, Definition]) -> tuple[str, ...]:
    if node.kind in LEAVES:
        return LEAVES[node.kind]
    if node.kind == SUBTREE:
        if node.id not in definitions:
            raise TreeError(f"no SubTree {node.id!r}; defined are {', '.join(definitions)}")
        return definitions[str(node.id)].ports
    if node.kind in (*SEQUENCES, *FALLBACKS, *DECORATORS):
        return ()
    raise TreeError(f"{node.kind!r} is no node of the contract, section 3")


def _check_cycles(definition: Definition, definitions: Mapping[str, Definition], above: tuple[str, ...]) -> None:
    if definition.id in above:
        raise TreeError(f"the SubTree {definition.id} contains itself")
    used = {str(node.id) for node in definition.root.walk() if node.kind == SUBTREE}
    for name in sorted(used):
        _check_cycles(definitions[name], definitions, (*above, definition.id))


def _definition_to_data(definition: Definition) -> dict[str, Any]:
    return {"ports": list(definition.ports), "root": _node_to_data(definition.root)}


def _definition_from_data(tree_id: str, data: Mapping[str, Any]) -> Definition:
    return Definition(tree_id, _node_from_data(data["root"]), tuple(data["ports"]))


def _node_to_data(node: Node) -> dict[str, Any]:
    data: dict[str, Any] = {"node": node.kind}
    if node.ports:
        data["ports"] = {name: list(value) if isinstance(value, tuple) else value for name, value in node.ports}
    if node.children:
        data["children"] = [_node_to_data(child) for child in node.children]
    if node.id is not None:
        data["id"] = node.id
    return data


def _node_from_data(data: Mapping[str, Any]) -> Node:
    ports = {
        name: tuple(float(number) for number in value) if isinstance(value, list) else value
        for name, value in data.get("ports", {}).items()
    }
    children = tuple(_node_from_data(child) for child in data.get("children", ()))
    return Node(data["node"], tuple(sorted(ports.items())), children, data.get("id"))
