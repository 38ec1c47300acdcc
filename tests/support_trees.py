"""Random trees of the contract for property tests: SubTrees, ports, entries, and numbers that are hard to write."""

from __future__ import annotations

from hypothesis import strategies as st

from learner.model.query import Site, written_sites
from learner.model.tree import Definition, Node, Tree, Value
from learner.model.vocabulary import DECORATORS, FALLBACKS, LEAVES, SEQUENCES, outputs_of, port_kind

NAMES = st.sampled_from(["A", "box", "marker_61", "cube-1.b", "0.05", "1e5", "0"])
"""Names that the contract admits, some of which look like numbers."""
NUMBERS = st.floats(-1e3, 1e3).map(lambda number: number + 0.0)
POSITIONS = st.tuples(NUMBERS, NUMBERS, NUMBERS)
SITES = st.lists(st.builds(Site, NAMES, POSITIONS, st.floats(1e-9, 0.1), st.booleans()), max_size=2)
PORT_VALUES: dict[str, st.SearchStrategy[Value]] = {
    "object": NAMES,
    "frame": NAMES,
    "state": st.sampled_from(["open", "closed"]),
    "radius": st.floats(1e-9, 0.1),
    "angle": st.floats(1e-9, 3.0),
    "position": POSITIONS,
    "orientation": st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS).filter(any),
    "kind": NAMES,
    "signal": NAMES,
    "value": st.sampled_from(["true", "false", "3", "0.5", '"open"']),
    "count": st.integers(0, 9).map(str),
    "at": SITES.map(lambda sites: written_sites(tuple(sites))),
    "not_at": SITES.map(lambda sites: written_sites(tuple(sites))),
}
Ports = dict[str, str]
"""What each port of a definition, and each entry that was written so far, may stand for, by its name."""


@st.composite
def trees(draw: st.DrawFn, max_subtrees: int = 3) -> Tree:
    """A tree whose SubTrees use only those made before them; every port of a SubTree is used by a leaf."""
    subtrees: list[tuple[Definition, Ports]] = []
    for index in range(draw(st.integers(0, max_subtrees))):
        prefix = draw(st.sampled_from(["Sub", "Recover_"]))
        kinds = draw(st.sets(st.sampled_from(sorted(PORT_VALUES)), max_size=3))
        ports = {f"my_{kind}": kind for kind in sorted(kinds)}
        subtrees.append((_definition(draw, f"{prefix}{index}", ports, subtrees), ports))
    main = _definition(draw, "Main", {}, subtrees)
    return Tree(main, tuple(definition for definition, _ in subtrees))


def _definition(draw: st.DrawFn, tree_id: str, ports: Ports, below: list[tuple[Definition, Ports]]) -> Definition:
    known = dict(ports)
    children = [_node(draw, known, below, 3) for _ in range(draw(st.integers(1, 3)))]
    children.extend(_user(draw, name, kind, known) for name, kind in ports.items())
    root = Node(draw(st.sampled_from([*SEQUENCES, *FALLBACKS])), (), tuple(children))
    return Definition(tree_id, root, tuple(ports))


def _node(draw: st.DrawFn, ports: Ports, below: list[tuple[Definition, Ports]], depth: int) -> Node:
    choice = draw(st.sampled_from(["leaf", "leaf", "control", "decorator", "subtree"]))
    if choice == "subtree" and below:
        definition, wanted = draw(st.sampled_from(below))
        values = [(name, _value(draw, kind, ports)) for name, kind in wanted.items()]
        return Node("SubTree", tuple(sorted(values)), (), definition.id)
    if choice == "control" and depth > 0:
        count = draw(st.integers(1, 3))
        children = tuple(_node(draw, ports, below, depth - 1) for _ in range(count))
        return Node(draw(st.sampled_from([*SEQUENCES, *FALLBACKS])), (), children)
    if choice == "decorator" and depth > 0:
        return Node(draw(st.sampled_from(DECORATORS)), (), (_node(draw, ports, below, depth - 1),))
    return _leaf(draw, draw(st.sampled_from(sorted(LEAVES))), ports)


def _user(draw: st.DrawFn, name: str, kind: str, known: Ports) -> Node:
    """A leaf that refers to the port of a name, so that no port stands idle."""
    using = [leaf for leaf, ports in sorted(LEAVES.items()) if kind in ports and kind not in outputs_of(leaf)]
    node = _leaf(draw, draw(st.sampled_from(using)), known)
    kept = [(port, value) for port, value in node.ports if port != kind]
    return Node(node.kind, tuple(sorted([*kept, (kind, f"{{{name}}}")])))


def _leaf(draw: st.DrawFn, kind: str, known: Ports) -> Node:
    outputs = outputs_of(kind)
    ports = [(port, _value(draw, port, known)) for port in LEAVES[kind] if port not in outputs]
    for port in outputs:
        entry = draw(st.sampled_from([f"{port_kind(port)}_{number}" for number in range(2)]))
        known[entry] = port
        ports.append((port, f"{{{entry}}}"))
    return Node(kind, tuple(sorted(ports)))


def _value(draw: st.DrawFn, port: str, known: Ports) -> Value:
    fitting = [name for name, kind in sorted(known.items()) if port_kind(kind) == port_kind(port)]
    if fitting and draw(st.booleans()):
        return f"{{{draw(st.sampled_from(fitting))}}}"
    return draw(PORT_VALUES[port])
