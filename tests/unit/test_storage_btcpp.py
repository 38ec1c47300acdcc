"""Trees in the XML of BehaviorTree.CPP (CONTRACT, section 3)."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import pytest
from hypothesis import HealthCheck, given, settings
from support_trees import trees

from learner.model.action import Pick, Place, SetGripper
from learner.model.condition import GripperIs, InGripper
from learner.model.tree import Definition, Tree, fallback, leaf, sequence, subtree
from learner.model.vocabulary import LEAVES, SECOND
from storage.btcpp import from_xml, to_xml, validate
from storage.errors import WrittenTreeError

UNIT = (0.0, 0.0, 0.0, 1.0)
PLACE = Place("A", "box", (0.1, -2e-7, 0.3), UNIT, (0.1, 0.0, 0.0))
GRASP = leaf(Pick("{what}", "{what}", (0.0, 0.0, 0.02), UNIT))
FETCH = Definition("Fetch", fallback(leaf(InGripper("{what}")), GRASP), ("what",))
TREE = Tree(
    Definition(
        "Main",
        sequence(
            leaf(GripperIs("open")),
            sequence(subtree("Fetch", what="A"), leaf(PLACE)),
            subtree("Fetch", what="B"),
            subtree("Fetch", what="A"),
        ),
    ),
    (FETCH,),
)


@given(trees())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_every_tree_comes_back_from_its_xml_and_equal_trees_have_equal_bytes(tree: Tree) -> None:
    text = to_xml(tree)
    assert from_xml(text) == tree
    assert from_xml(text).digest == tree.digest
    assert to_xml(from_xml(text)) == text


@given(trees())
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_every_tree_keeps_the_form_of_the_contract(tree: Tree) -> None:
    root = ET.fromstring(to_xml(tree))
    assert (root.get("BTCPP_format"), root.get("main_tree_to_execute")) == ("4", tree.main.id)
    for element in root.iter():
        assert not [attribute for attribute in element.attrib if attribute.startswith("_")]
        assert re.fullmatch("[A-Za-z0-9_]+", element.get("name", "x"))
        names = [child.get("name") for child in element if child.tag == "SubTree"]
        assert len(names) == len(set(names))
    listed = {entry.get("ID"): [port.get("name") for port in entry] for entry in root.findall("TreeNodesModel/*")}
    known = {kind: ports for kind, ports in LEAVES.items() if kind in tree.leaves or kind not in SECOND}
    assert listed == {kind: list(ports) for kind, ports in known.items()}


def test_positions_are_numbers_joined_by_semicolons() -> None:
    place = ET.fromstring(to_xml(TREE)).find(".//BehaviorTree//Place")
    assert place is not None
    assert place.get("position") == "0.1;-2e-07;0.3"
    assert place.get("orientation") == "0.0;0.0;0.0;1.0"


def test_subtrees_are_named_after_what_they_do() -> None:
    tree = Tree(Definition("Main", sequence(subtree("Fetch", object="cube-1.b"))), (_fetch("object"),))
    call = ET.fromstring(to_xml(tree)).find(".//SubTree")
    assert call is not None
    assert call.get("name") == "Fetch_cube_1_b"
    assert call.get("object") == "cube-1.b"


def _fetch(port: str) -> Definition:
    return Definition("Fetch", fallback(leaf(InGripper(f"{{{port}}}")), leaf(SetGripper("open"))), (port,))


def test_the_type_of_a_port_follows_from_the_leaf_at_which_it_ends() -> None:
    inner = Definition("Inner", leaf(Pick("{o}", "{o}", "{p}", UNIT)), ("o", "p"))  # type: ignore[arg-type]
    outer = Definition("Outer", subtree("Inner", o="{o}", p="{where}"), ("o", "where"))
    tree = Tree(Definition("Main", subtree("Outer", o="0.05", where=(1.0, 2.0, 3.0))), (inner, outer))
    call = from_xml(to_xml(tree)).main.root
    assert dict(call.ports) == {"o": "0.05", "where": (1.0, 2.0, 3.0)}


def refused(*replacements: tuple[str, str]) -> str:
    text = to_xml(TREE)
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(WrittenTreeError) as caught:
        validate(text)
    return str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ('BTCPP_format="4"', 'BTCPP_format="3"', "BehaviorTree.CPP 4"),
        ('main_tree_to_execute="Main"', 'main_tree_to_execute="Other"', "Other"),
        ('main_tree_to_execute="Main"', "", "main_tree_to_execute"),
        ("<root ", "<!DOCTYPE root><root ", "DOCTYPE"),
        ("</TreeNodesModel>", "</TreeNodesModel><include path='x'/>", "include"),
        ("<GripperIs state", '<Condition ID="GripperIs" state', "compact"),
        ("<GripperIs state", "<Wave state", "Wave"),
        ('<GripperIs state="open"', '<GripperIs state="open" _skipIf="true"', "_skipIf"),
        ('<GripperIs state="open"', '<GripperIs state="ajar"', "ajar"),
        ('<GripperIs state="open"', '<GripperIs state="open" name="is open"', "is open"),
        ('<GripperIs state="open"', '<GripperIs state="open" name="v1.2"', "v1.2"),
        ('<GripperIs state="open"', '<GripperIs state="open" extra="1"', "extra"),
        ('<GripperIs state="open"', "<GripperIs", "state"),
        ('name="Fetch_B"', 'name="Fetch_B" _autoremap="true"', "_autoremap"),
        ('name="Fetch_B"', 'name="Fetch_A_2"', "Fetch_A_2"),
        ('what="B"', "", "what"),
        ('what="B"', 'what="{who}"', "who"),
        ('what="B"', 'what="x{who}"', "x{who}"),
        ('what="B"', 'what="no name"', "no name"),
        ('what="B"', 'what="none"', "none"),
        ("0.1;-2e-07;0.3", "0.1,-2e-07,0.3", "0.1,"),
        ("0.1;-2e-07;0.3", "0.1;nan;0.3", "nan"),
        ("0.1;-2e-07;0.3", "0.1;0.3", "2 numbers"),
        ('SubTree ID="Fetch"', 'SubTree ID="Fetsch"', "Fetsch"),
        ('BehaviorTree ID="Fetch"', 'BehaviorTree ID="Fe.tch"', "Fe.tch"),
        ('BehaviorTree ID="Fetch"', 'BehaviorTree ID="Sequence"', "Sequence"),
        ('BehaviorTree ID="Fetch"', 'BehaviorTree ID="Main"', "Main"),
        ('<Action ID="Place">', '<Action ID="Plaice">', "Plaice"),
        ('<Condition ID="InGripper">', '<Action ID="InGripper">', ""),
        ('<input_port name="orientation">quaternion x;y;z;w in frame</input_port>', "", "orientation"),
        ("</root>", "", "XML"),
    ],
)
def test_what_the_contract_refuses_is_refused_and_named(old: str, new: str, named: str) -> None:
    assert named in refused((old, new))


def test_a_leaf_that_the_model_does_not_list_is_refused() -> None:
    text = re.sub(r'<Action ID="Place">.*?</Action>', "", to_xml(TREE), flags=re.DOTALL)
    with pytest.raises(WrittenTreeError, match="does not list Place"):
        validate(text)


def test_twins_beside_each_other_are_refused_even_without_a_name() -> None:
    assert "Fetch" in refused((' name="Fetch_B"', ""), (' name="Fetch_A_2"', ""))


def nested(levels: int) -> str:
    body = "<ForceSuccess>" * (levels - 1) + '<GripperIs state="open"/>' + "</ForceSuccess>" * (levels - 1)
    return re.sub(r'<BehaviorTree ID="Main">.*?</BehaviorTree>', f'<BehaviorTree ID="Main">{body}</BehaviorTree>',
                  to_xml(TREE), count=1, flags=re.DOTALL)  # fmt: skip


def test_nesting_stays_below_250_however_deep_a_text_is() -> None:
    validate(nested(249))
    for levels in (250, 100_000):
        with pytest.raises(WrittenTreeError, match="levels deep"):
            validate(nested(levels))


def test_a_subtree_counts_as_a_level() -> None:
    chain = [Definition("T0", leaf(GripperIs("open")))]
    chain.extend(Definition(f"T{i}", subtree(f"T{i - 1}")) for i in range(1, 250))
    with pytest.raises(WrittenTreeError, match="levels deep"):
        to_xml(Tree(chain[-1], tuple(chain[:-1])))


def test_subtrees_that_multiply_or_contain_themselves_are_refused_before_they_are_expanded() -> None:
    uses = '<SubTree ID="T{1}" name="a"/><SubTree ID="T{1}" name="b"/>'
    twice = f'<BehaviorTree ID="T{{0}}"><Sequence>{uses}</Sequence></BehaviorTree>'
    bomb = "".join(twice.format(i, i - 1) for i in range(1, 60))
    end = '<BehaviorTree ID="T0"><GripperIs state="open"/></BehaviorTree></root>'
    with pytest.raises(WrittenTreeError, match="nodes with its SubTrees filled in"):
        validate(to_xml(TREE).replace("</root>", bomb + end))
    with pytest.raises(WrittenTreeError, match="contains itself"):
        validate(
            to_xml(TREE).replace("</root>", bomb + '<BehaviorTree ID="T0"><SubTree ID="T9"/></BehaviorTree></root>')
        )


def test_a_tree_with_a_number_that_is_not_finite_cannot_be_read() -> None:
    text = to_xml(TREE)
    assert "0.3" in text
    with pytest.raises(WrittenTreeError, match="position"):
        from_xml(text.replace("0.3", "inf"))


def test_a_port_that_no_leaf_uses_is_refused() -> None:
    idle = Definition("Idle", leaf(GripperIs("open")), ("spare",))
    with pytest.raises(WrittenTreeError):
        to_xml(Tree(Definition("Main", subtree("Idle", spare="A")), (idle,)))
