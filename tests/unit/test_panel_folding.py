"""A tree as lines for a person: a line for each placement, each node at its place in the flattened tree."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from support_trees import trees

from learner.model import Definition, GripperIs, InGripper, Node, ObjectAt, SetGripper, Tree
from learner.model.tree import Value, fallback, leaf, negated, sequence, subtree
from pipelines.panel.folding import Folding, Line, Told
from pipelines.panel.goals import destinations, goals_of
from pipelines.panel.sentences import LANGUAGES, Voice

DOWN = (1.0, 0.0, 0.0, 0.0)


def motion(kind: str, name: str, frame: str, at: tuple[float, float, float]) -> Node:
    return Node(kind, (("frame", frame), ("object", name), ("orientation", DOWN), ("position", at)))


HOLD = Definition(
    "Hold",
    fallback(
        leaf(InGripper("{object}")),
        sequence(
            fallback(leaf(GripperIs("open")), leaf(SetGripper("open"))),
            motion("Pick", "{object}", "{object}", (0, 0, 0)),
        ),
    ),
    ("object",),
)
TURN = Definition("Recover_Turn", negated(sequence(motion("Pick", "A", "A", (0.0, 0.0, 0.0)))))


def placement(name: str, at: tuple[float, float, float]) -> Node:
    chain = sequence(subtree("Hold", object=name), motion("Place", name, "box", at))
    return fallback(leaf(ObjectAt(name, "box", at, 0.02)), chain, subtree("Recover_Turn"))


TREE = Tree(
    Definition("task", sequence(placement("A", (0.1, 0.0, 0.0)), placement("B", (0.2, 0.0, 0.0)))), (HOLD, TURN)
)


def walk(folding: Folding, line: Line) -> Iterator[Line]:
    yield line
    for part in folding.parts(line):
        yield from walk(folding, part)


def plain(node: Node) -> dict[str, Value]:
    """The ports of a node of a flattened tree; entries as they are written, not told apart by their use."""
    return {name: re.sub(r"\.\d+}", "}", v) if isinstance(v, str) else v for name, v in node.ports}


@settings(max_examples=50, deadline=None)
@given(trees())
def test_each_line_is_the_node_at_its_place_in_the_flattened_tree(tree: Tree) -> None:
    folding, flat = Folding(tree), list(tree.flattened().walk())
    lines = list(walk(folding, folding.root))
    assert [line.index for line in lines] == list(range(len(flat)))
    assert [(line.node.kind, line.ports) for line in lines] == [(node.kind, plain(node)) for node in flat]
    assert folding.size(folding.root) == len(flat)


@settings(max_examples=50, deadline=None)
@given(trees())
def test_what_only_recovers_is_what_the_tree_counts_so(tree: Tree) -> None:
    folding = Folding(tree)
    recovering = [line for line in walk(folding, folding.root) if line.recovers]
    assert len(recovering) == tree.nodes_recovery


@settings(max_examples=30, deadline=None)
@given(trees())
def test_every_line_of_any_tree_has_words_in_every_language(tree: Tree) -> None:
    folding = Folding(tree)
    for language in LANGUAGES:
        told = Told(folding, Voice(language))
        assert all(told.line(line).strip() and told.ports(line) for line in walk(folding, folding.root))


def test_a_placement_is_one_line_as_the_paper_writes_it() -> None:
    folding = Folding(TREE)
    told = Told(folding, Voice("en"))
    assert not folding.is_folded(folding.root)
    parts = folding.parts(folding.root)
    assert all(folding.is_folded(part) for part in parts)
    assert [told.line(part) for part in parts] == [
        "Pick A and Place at (100, 0, 0) mm in box",
        "Pick B and Place at (200, 0, 0) mm in box",
    ]


def test_a_placement_unfolds_to_its_last_leaf() -> None:
    folding = Folding(TREE)
    told = Told(folding, Voice("de"))
    condition, chain, recovery = folding.parts(folding.parts(folding.root)[1])
    hold, place = folding.parts(chain)
    held, _ = folding.parts(hold)
    assert told.line(condition) == "Liegt B innerhalb 20 mm um (200, 0, 0) mm in box?"
    assert told.line(chain) == "Eins nach dem anderen, jedes bleibt erfüllt"
    assert told.line(held) == "Wird B gehalten?"
    assert "position = 0.2; 0; 0" in told.ports(place)
    assert told.line(recovery) == "Behebt, was nicht vorgemacht wurde (3 Knoten)"


def test_a_node_that_was_not_known_when_the_sentences_were_written_is_told_with_its_ports() -> None:
    line = Line(0, Node("FindCube", (("kind", "cube"), ("object", "{found}"))), {}, False)
    told = Told(Folding(TREE), Voice("en"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pipelines.panel.folding.LEAVES", {"FindCube": ("kind", "object")})
        assert told.line(line) == "FindCube kind=cube object={found}"


@settings(max_examples=50, deadline=None)
@given(trees())
def test_the_places_of_any_tree_can_be_drawn(tree: Tree) -> None:
    goals = goals_of(tree)
    assert len(destinations(goals, {}, "base")) <= len(goals)


def test_the_places_of_a_tree_are_those_of_its_conditions_without_what_recovers() -> None:
    assert [(goal.object, goal.position) for goal in goals_of(TREE)] == [("A", (0.1, 0.0, 0.0)), ("B", (0.2, 0.0, 0.0))]
