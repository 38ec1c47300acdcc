"""Trees as plain data: canonical JSON, digest, flattening, and everything that is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support_trees import trees

from learner.errors import TreeError
from learner.model import Definition, GripperIs, InGripper, Node, ObjectAt, Pick, Place, SetGripper, Tree
from learner.model.tree import FORMAT, MAX_DEPTH, Value, fallback, leaf, sequence, subtree
from learner.model.vocabulary import ENTRY

DOWN = (1.0, 0.0, 0.0, 0.0)
OPEN = leaf(GripperIs("open"))
AT = leaf(ObjectAt("A", "box", (0.0, 0.0, 0.03), 0.05))
PICK = leaf(Pick("A", "A", (0.0, 0.0, 0.01), DOWN))
PLACE = leaf(Place("A", "box", (0.0, 0.0, 0.04), DOWN, (0.0, 0.0, 0.03)))
HOLD = Definition(
    "Hold",
    fallback(
        Node("InGripper", (("object", "{object}"),)),
        Node("Pick", (("frame", "{object}"), ("object", "{object}"), ("orientation", DOWN), ("position", "{at}"))),
    ),
    ("object", "at"),
)
CLEAR = Definition("Recover_clear", sequence(OPEN, PICK))
USE = subtree("Hold", object="A", at=(0.0, 0.0, 0.01))
TREE = Tree(
    Definition("main", fallback(AT, sequence(subtree("Recover_clear"), USE, PLACE))),
    (HOLD, CLEAR),
)


def single(root: Node) -> Tree:
    return Tree(Definition("main", root))


@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=60)
@given(trees())
def test_json_is_a_round_trip_and_canonical(tree: Tree) -> None:
    text = tree.to_json()
    again = Tree.from_json(text)
    assert again == tree
    assert again.to_json() == text
    assert Tree.from_json(text.encode()).digest == tree.digest
    assert text.isascii()
    assert json.dumps(json.loads(text), sort_keys=True, separators=(",", ":")) == text


@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=60)
@given(trees())
def test_a_flat_tree_has_no_subtrees_no_ports_of_them_and_all_the_nodes(tree: Tree) -> None:
    flat = tree.flattened()
    nodes = list(flat.walk())
    assert not any(node.kind == "SubTree" for node in nodes)
    references = {value for node in nodes for _, value in node.ports if isinstance(value, str) and "{" in value}
    assert all(ENTRY.fullmatch(value) for value in references)
    assert len(nodes) == flat.size
    assert single(flat).flattened() == flat


@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=60)
@given(trees())
def test_the_order_of_the_subtrees_has_no_meaning(tree: Tree) -> None:
    turned_around = Tree(tree.main, tuple(reversed(tree.subtrees)))
    assert turned_around == tree
    assert turned_around.digest == tree.digest


def test_the_digest_of_a_tree_never_changes() -> None:
    assert TREE.digest == "ce928ef60b2cb6fac44ddbebb568aecb9588b2891dfda802cde2c8240ff94c90"


@pytest.mark.parametrize(
    "other",
    [
        replace(TREE, main=replace(TREE.main, id="other")),
        replace(TREE, main=Definition("main", fallback(AT, sequence(subtree("Recover_clear"), PLACE, USE)))),
        replace(TREE, main=Definition("main", fallback(AT, sequence(USE, PLACE, reactive=False)))),
    ],
)
def test_another_tree_has_another_digest(other: Tree) -> None:
    assert other.digest != TREE.digest


def test_ports_of_subtrees_are_filled_in() -> None:
    picks = [node for node in TREE.flattened(recovery=False).walk() if node.kind == "Pick"]
    assert [(node.port("object"), node.port("frame"), node.port("position")) for node in picks] == [
        ("A", "A", (0.0, 0.0, 0.01))
    ]


def test_ports_pass_through_nested_subtrees() -> None:
    outer = Definition("Outer", subtree("Hold", object="{what}", at=(1.0, 2.0, 3.0)), ("what",))
    flat = Tree(Definition("main", subtree("Outer", what="B")), (HOLD, outer)).flattened()
    assert flat.children[0] == leaf(InGripper("B"))
    assert flat.children[1] == leaf(Pick("B", "B", (1.0, 2.0, 3.0), DOWN))


def test_nodes_are_counted_flat_and_recovery_apart() -> None:
    assert TREE.nodes == 1 + 1 + 1 + 3 + 1
    assert TREE.nodes_recovery == 3
    assert TREE.flattened().size == TREE.nodes + TREE.nodes_recovery
    assert TREE.nodes_written == 6 + 3 + 3


def test_a_shared_subtree_counts_every_time_when_flat_and_once_when_written() -> None:
    tree = Tree(Definition("main", sequence(USE, subtree("Hold", object="B", at=(0.0, 0.0, 0.0)))), (HOLD,))
    assert tree.nodes == 1 + 3 + 3
    assert tree.nodes_written == 3 + 3


def test_a_tree_tells_its_objects_and_frames_without_none() -> None:
    tree = single(sequence(AT, leaf(InGripper("none")), leaf(InGripper("B")), PICK))
    assert tree.objects() == {"A", "B"}
    assert tree.frames() == {"box", "A"}


def test_a_node_without_the_port_asked_for_is_a_key_error() -> None:
    with pytest.raises(KeyError):
        OPEN.port("object")


def nested(depth: int) -> Node:
    node = OPEN
    for _ in range(depth - 1):
        node = Node("Inverter", (), (node,))
    return node


def with_ports(kind: str, **ports: object) -> Node:
    return Node(kind, tuple(sorted(ports.items())))  # type: ignore[arg-type]


SPOT = {"object": "A", "frame": "box", "position": (0.0, 0.0, 0.0)}
REFUSED = {
    "an unknown node": (Node("Parallel", (), (OPEN,)), "Parallel"),
    "a control node without children": (Node("Sequence"), "0 children"),
    "a decorator with two children": (Node("Inverter", (), (OPEN, OPEN)), "2 children"),
    "a decorator without a child": (Node("ForceSuccess"), "0 children"),
    "a leaf with a child": (Node("GripperIs", OPEN.ports, (OPEN,)), "1 children"),
    "a control node with ports": (Node("Sequence", (("state", "open"),), (OPEN,)), "ports"),
    "a missing port": (Node("GripperIs"), "ports"),
    "a port too many": (with_ports("GripperIs", state="open", object="A"), "ports"),
    "a port twice": (Node("GripperIs", (("state", "open"), ("state", "open"))), "ports"),
    "a state that is none": (with_ports("SetGripper", state="ajar"), "ajar"),
    "a radius of nothing": (with_ports("ObjectAt", radius=0.0, **SPOT), "radius"),
    "a radius below nothing": (with_ports("ObjectAt", radius=-0.1, **SPOT), "radius"),
    "a radius that is no number": (with_ports("ObjectAt", radius="0.05", **SPOT), "radius"),
    "a position of two numbers": (with_ports("ObjectAt", radius=0.1, **{**SPOT, "position": (0.0, 0.0)}), "position"),
    "an orientation of three numbers": (with_ports("Pick", orientation=(0.0, 0.0, 1.0), **SPOT), "orientation"),
    "an object that is a number": (with_ports("InGripper", object=3.0), "object"),
    "a SubTree that is not defined": (subtree("Nowhere"), "Nowhere"),
    "a reference outside a SubTree": (with_ports("InGripper", object="{object}"), "object"),
    "nesting too deep": (nested(MAX_DEPTH), "levels deep"),
}


@pytest.mark.parametrize(("root", "named"), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_no_tree_of_the_contract_is_refused(root: Node, named: str) -> None:
    with pytest.raises(TreeError, match=named):
        single(root)


def test_nesting_just_below_the_bound_is_admitted() -> None:
    assert single(nested(MAX_DEPTH - 1)).flattened().depth == MAX_DEPTH - 1


@pytest.mark.parametrize("tree_id", ["", "a b", "a.b", "1st", "ä", "a\n"])
def test_an_id_of_other_characters_is_refused(tree_id: str) -> None:
    with pytest.raises(TreeError, match="ID"):
        Tree(Definition(tree_id, OPEN))


def test_two_subtrees_of_one_id_are_refused() -> None:
    with pytest.raises(TreeError, match="one ID"):
        Tree(Definition("main", OPEN), (CLEAR, CLEAR))


def test_a_subtree_that_contains_itself_is_refused() -> None:
    a = Definition("A", sequence(subtree("B")))
    b = Definition("B", sequence(subtree("A")))
    with pytest.raises(TreeError, match="contains itself"):
        Tree(Definition("main", subtree("A")), (a, b))


def test_a_subtree_without_one_of_its_ports_is_refused() -> None:
    with pytest.raises(TreeError, match="ports"):
        Tree(Definition("main", subtree("Hold", object="A")), (HOLD,))


@pytest.mark.parametrize("at", ["nowhere", (0.0, 0.0), (0.0, 0.0, float("nan")), 3.0], ids=repr)
def test_a_value_that_does_not_fit_is_refused_also_through_the_port_of_a_subtree(at: Value) -> None:
    with pytest.raises(TreeError, match="position"):
        Tree(Definition("main", subtree("Hold", object="A", at=at)), (HOLD,))


def single_json(root: str) -> str:
    return f'{{"format":"{FORMAT}","main":"m","trees":{{"m":{{"ports":[],"root":{root}}}}}}}'


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        "{",
        "{}",
        json.dumps({"format": FORMAT}),
        json.dumps({"format": FORMAT, "main": "m", "trees": {}}),
        json.dumps({"format": FORMAT, "main": "m", "trees": {"m": {"ports": []}}}),
        json.dumps({"format": FORMAT, "main": "m", "trees": {"m": {"ports": [], "root": {"node": "Nothing"}}}}),
        TREE.to_json().replace(FORMAT, "treewright.tree/2"),
        "[" * 100_000,
        single_json('{"node":"Inverter","children":[' * 600 + "{}" + "]}" * 600),
    ],
    ids=lambda text: text[:60],
)
def test_json_that_is_no_tree_is_refused(text: str) -> None:
    with pytest.raises(TreeError):
        Tree.from_json(text)


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_a_number_that_is_not_finite_is_refused(number: float) -> None:
    with pytest.raises(TreeError):
        single(with_ports("Pick", orientation=DOWN, object="A", frame="A", position=(0.0, 0.0, number)))


def test_a_leaf_carries_exactly_the_ports_of_the_contract() -> None:
    assert dict(PLACE.ports) == {
        "object": "A",
        "frame": "box",
        "position": (0.0, 0.0, 0.04),
        "orientation": DOWN,
    }
    assert leaf(SetGripper("open")).ports == (("state", "open"),)


@given(st.sampled_from(["Sequence", "Fallback"]), st.booleans())
def test_control_nodes_are_reactive_unless_told_otherwise(kind: str, reactive: bool) -> None:
    build = sequence if kind == "Sequence" else fallback
    assert build(OPEN).kind == f"Reactive{kind}"
    assert build(OPEN, reactive=False).kind == kind
