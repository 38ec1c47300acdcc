"""Pictures of trees."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from hypothesis import HealthCheck, given, settings
from support_trees import trees

from learner.model import Drop, Pick, Tree
from learner.model.condition import GripperIs, InGripper
from learner.model.tree import Definition, fallback, leaf, sequence, subtree
from storage.picture import Box, _box, _place, to_svg

SVG = "{http://www.w3.org/2000/svg}"
UNIT = (0.0, 0.0, 0.0, 1.0)
DROP = Drop("A", "box", (0.1, 0.0, 0.2), UNIT, (0.1, 0.0, 0.0))
FETCH = Definition("Fetch", fallback(leaf(InGripper("{o}")), leaf(Pick("{o}", "{o}", (0.0, 0.0, 0.0), UNIT))), ("o",))
RECOVER = Definition("Recover_grasp", sequence(leaf(GripperIs("open")), leaf(InGripper("none"))))
TREE = Tree(
    Definition(
        "kitting",
        fallback(leaf(DROP.achieves), sequence(subtree("Fetch", o="A"), leaf(DROP)), subtree("Recover_grasp")),
    ),
    (FETCH, RECOVER),
)


def texts(svg: str) -> list[str]:
    return ["".join(element.itertext()) for element in ET.fromstring(svg).iter(f"{SVG}text")]


def test_leaves_say_what_they_do_where() -> None:
    said = texts(to_svg(TREE))
    assert "ObjectRoughlyAt A in box(0.100, 0.000, 0.000) ± 10 cm" in said
    assert "Drop A in box(0.100, 0.000, 0.200)" in said
    assert "Pick A in A(0.000, 0.000, 0.000)" in said
    assert "InGripper A" in said


def test_subtrees_are_drawn_where_they_are_used_and_recovery_is_one_box() -> None:
    said = texts(to_svg(TREE))
    assert "Fetch A" in said
    assert "Recover_grasp3 nodes" in said
    assert not [text for text in said if "GripperIs" in text]
    assert any("7 nodes, and 3 that only recover" in text for text in said)


@given(trees())
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_every_picture_is_self_contained_xml_and_equal_trees_have_equal_bytes(tree: Tree) -> None:
    svg = to_svg(tree)
    assert to_svg(Tree.from_json(tree.to_json())) == svg
    assert ET.fromstring(svg).tag == f"{SVG}svg"
    assert not re.search(r"href|@import|url\(|<script", svg)


@given(trees())
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_no_two_boxes_overlap_and_all_lie_within_the_picture(tree: Tree) -> None:
    root = _box(tree.main.root, {}, tree)
    bottom = _place(root, 0.0, 0.0)
    boxes: list[Box] = list(root.walk())
    for index, a in enumerate(boxes):
        assert a.y + 24 <= bottom
        for b in boxes[index + 1 :]:
            apart = a.x + a.width <= b.x or b.x + b.width <= a.x or a.y + 24 <= b.y or b.y + 24 <= a.y
            assert apart, f"{a} and {b} overlap"


def test_what_a_name_could_hold_is_escaped() -> None:
    tree = Tree(Definition("Main", leaf(InGripper("<b>&\"'"))))
    assert "InGripper <b>&\"'" in texts(to_svg(tree))
