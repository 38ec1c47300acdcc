"""Random trees of the contract for property tests: with SubTrees, ports, and numbers that are hard to write."""

from __future__ import annotations

from hypothesis import strategies as st

from learner.model.tree import DECORATORS, FALLBACKS, LEAVES, SEQUENCES, Definition, Node, Tree, Value

NAMES = st.sampled_from(["A", "box", "marker_61", "cube-1.b", "0.05", "1e5", "0"])
"""Names that the contract admits, some of which look like numbers."""
NUMBERS = st.floats(-1e3, 1e3).map(lambda number: number + 0.0)
PORT_VALUES: dict[str, st.SearchStrategy[Value]] = {
    "object": NAMES,
    "frame": NAMES,
    "state": st.sampled_from(["open", "closed"]),
    "radius": st.floats(1e-9, 0.1),
    "angle": st.floats(1e-9, 3.0),
    "position": st.tuples(NUMBERS, NUMBERS, NUMBERS),
    "orientation": st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS),
}
Ports = dict[str, str]
"""The kind of each port of a definition, by its name."""


@st.composite
def trees(draw: st.DrawFn, max_subtrees: int = 3) -> Tree:
    """A tree whose SubTrees use only those made before them; every port of a SubTree is used by a leaf."""
    subtrees: list[tuple[Definition, Ports]] = []
    for index in range(draw(st.integers(0, max_subtrees))):
        prefix = draw(st.sampled_from(["Sub", "Recover_"]))
        kinds = draw(st.sets(st.sampled_from(sorted(PORT_VALUES)), max_size=3))
        subtrees.append(_definition(draw, f"{prefix}{index}", {f"my_{kind}": kind for kind in kinds}, subtrees))
    main, _ = _definition(draw, "Main", {}, subtrees)
    return Tree(main, tuple(definition for definition, _ in subtrees))


def _definition(
    draw: st.DrawFn, tree_id: str, ports: Ports, below: list[tuple[Definition, Ports]]
) -> tuple[Definition, Ports]:
    children = [_node(draw, ports, below, 3) for _ in range(draw(st.integers(1, 3)))]
    children.extend(_user(draw, kind, ports) for kind in ports.values())
    root = Node(draw(st.sampled_from([*SEQUENCES, *FALLBACKS])), (), tuple(children))
    return Definition(tree_id, root, tuple(ports)), ports


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


def _user(draw: st.DrawFn, port_kind: str, ports: Ports) -> Node:
    """A leaf that refers to the port of this kind, so that no port stands idle."""
    kind = draw(st.sampled_from([kind for kind, names in sorted(LEAVES.items()) if port_kind in names]))
    node = _leaf(draw, kind, ports)
    kept = [(name, value) for name, value in node.ports if name != port_kind]
    return Node(kind, tuple(sorted([*kept, (port_kind, f"{{my_{port_kind}}}")])))


def _leaf(draw: st.DrawFn, kind: str, ports: Ports) -> Node:
    return Node(kind, tuple(sorted((port, _value(draw, port, ports)) for port in LEAVES[kind])))


def _value(draw: st.DrawFn, port_kind: str, ports: Ports) -> Value:
    fitting = [name for name, kind in sorted(ports.items()) if kind == port_kind]
    if fitting and draw(st.booleans()):
        return f"{{{fitting[0]}}}"
    return draw(PORT_VALUES[port_kind])
