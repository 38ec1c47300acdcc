"""What changed between two trees, in words."""

from __future__ import annotations

import math

from hypothesis import HealthCheck, given, settings
from support_trees import trees

from learner.model import Drop, Pick, Place, Tree
from learner.model.tree import Definition, fallback, leaf, sequence, subtree
from storage.difference import Change, differences

UNIT = (0.0, 0.0, 0.0, 1.0)
Release = Place | Drop


def place(name: str, frame: str, x: float = 0.1, radius: float = 0.05) -> Place:
    return Place(name, frame, (x, 0.0, 0.2), UNIT, (x, 0.0, 0.0), radius)


def tree(*releases: Release, grasp_m: float = 0.0) -> Tree:
    steps = [
        fallback(
            leaf(release.achieves),
            sequence(leaf(Pick(release.object, release.object, (grasp_m, 0.0, 0.0), UNIT)), leaf(release)),
        )
        for release in releases
    ]
    return Tree(Definition("Main", sequence(*steps)))


def changes(old: Tree, new: Tree, what: str) -> list[Change]:
    return [change for change in differences(old, new) if change.what == what]


@given(trees(), trees())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_equal_trees_have_no_differences_and_others_have_some(one: Tree, other: Tree) -> None:
    assert differences(one, Tree.from_json(one.to_json())) == ()
    assert bool(differences(one, other)) == (one != other)


@given(trees(), trees())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_what_is_a_new_goal_one_way_is_a_lost_one_the_other_way(one: Tree, other: Tree) -> None:
    there = [(change.before, change.after) for change in changes(one, other, "goal")]
    back = [(change.after, change.before) for change in changes(other, one, "goal")]
    assert sorted(map(str, there)) == sorted(map(str, back))


def test_a_goal_that_came_and_one_that_went_are_named() -> None:
    said = {change.sentence for change in changes(tree(place("A", "box")), tree(place("B", "tray")), "goal")}
    assert said == {"B at tray is a goal now", "A at box is no goal any more"}


def test_a_second_place_of_one_object_in_one_frame_is_told_by_its_position() -> None:
    one, two = tree(place("A", "box", 0.1)), tree(place("A", "box", 0.1), place("A", "box", 0.4))
    assert [each.sentence for each in changes(one, two, "goal")] == ["A at box (400, 0, 0 mm) is a goal now"]
    assert [each.sentence for each in changes(two, one, "goal")] == ["A at box (400, 0, 0 mm) is no goal any more"]


def test_another_order_of_the_same_goals_is_told_with_both_orders() -> None:
    a, b, c = place("A", "box"), place("B", "box", 0.2), place("C", "box", 0.3)
    (change,) = differences(tree(a, b), tree(b, a))
    assert change.sentence == "the order is B at box, A at box now; it was A at box, B at box"
    assert changes(tree(a, b), tree(a, c, b), "order") == []


def test_another_frame_is_told_once_and_no_numbers_of_two_frames_are_compared() -> None:
    said = differences(tree(place("A", "base", 0.4)), tree(place("A", "box", 0.1)))
    assert [(each.what, each.before, each.after) for each in said] == [("frame", "base", "box")]
    assert said[0].sentence == "A is put relative to box now; it was relative to base"


def test_a_pose_is_told_in_millimetres_along_each_axis() -> None:
    goal, hand = changes(tree(place("A", "box", 0.1)), tree(place("A", "box", 0.112)), "pose")
    assert goal.sentence == "the goal of A lies 12.0 mm off (+12.0, +0.0, +0.0) relative to box"
    assert hand.sentence == "the hand lets A go 12.0 mm off (+12.0, +0.0, +0.0) relative to box"
    assert hand.after == {"frame": "box", "position_mm": [112.0, 0.0, 200.0], "orientation": UNIT}
    (grasp,) = changes(tree(place("A", "box")), tree(place("A", "box"), grasp_m=-0.0031), "pose")
    assert grasp.sentence == "the hand grasps A 3.1 mm off (-3.1, +0.0, +0.0) relative to A"


def test_a_turn_is_told_in_degrees_and_a_quaternion_and_its_negative_are_one() -> None:
    old, half = Place("A", "box", (0.1, 0.0, 0.2), UNIT, (0.1, 0.0, 0.0)), math.radians(5)
    turned = Place("A", "box", (0.1, 0.0, 0.2), (0.0, 0.0, math.sin(half), math.cos(half)), (0.1, 0.0, 0.0))
    (change,) = differences(tree(old), tree(turned))
    assert change.sentence == "the hand lets A go turned by 10.0 degrees relative to box"
    flipped = Place("A", "box", (0.1, 0.0, 0.2), (0.0, 0.0, 0.0, -1.0), (0.1, 0.0, 0.0))
    (change,) = differences(tree(old), tree(flipped))
    assert change.sentence.startswith("the hand lets A go turned by less than 0.1 degrees")


def test_tolerances_are_told_with_as_many_digits_as_tell_them_apart() -> None:
    (change,) = differences(tree(place("A", "box", radius=0.05)), tree(place("A", "box", radius=0.035)))
    assert change.sentence == "A at box counts as reached within 35.0 mm; it was 50.0 mm"
    assert (change.before, change.after) == ({"mm": 50.0}, {"mm": 35.0})
    (change,) = differences(tree(place("A", "box", radius=0.05)), tree(place("A", "box", radius=0.050001)))
    assert change.sentence == "A at box counts as reached within 50.001 mm; it was 50.000 mm"


def test_an_orientation_that_begins_to_count_is_a_tolerance() -> None:
    posed = Place("A", "box", (0.1, 0.0, 0.2), UNIT, (0.1, 0.0, 0.0), turned=(UNIT, math.radians(10)))
    (change,) = differences(tree(place("A", "box")), tree(posed))
    assert change.what == "tolerance"
    assert "only if turned within 10.0 degrees" in change.sentence
    (change,) = differences(tree(posed), tree(place("A", "box")))
    assert "whatever way it is turned; it was within 10.0 degrees" in change.sentence


def test_a_place_that_became_a_drop_is_a_label() -> None:
    drop = Drop("A", "box", (0.1, 0.0, 0.2), UNIT, (0.1, 0.0, 0.0), 0.05)
    (change,) = changes(tree(place("A", "box")), tree(drop), "label")
    assert change.sentence == "A is dropped relative to box now; it was placed"


def test_places_of_one_object_that_are_near_go_together_in_their_order() -> None:
    first, then = place("A", "box", 0.100), place("A", "box", 0.104)
    moved = tree(place("A", "box", 0.103), place("A", "box", 0.099))
    assert changes(tree(first, then), moved, "order") == []


def test_recovery_is_one_change_however_many_subtrees_it_has() -> None:
    here = Definition("Recover_A", leaf(Pick("A", "A", (0.0, 0.0, 0.0), UNIT)))
    there = Definition("Recover_A", leaf(Pick("A", "A", (0.0, 0.0, 0.1), UNIT)))
    with_it, other = (
        Tree(Definition("Main", sequence(subtree("Recover_A"), leaf(place("A", "box")))), (each,))
        for each in (here, there)
    )
    (change,) = differences(with_it, other)
    assert change.sentence == "recovery has 1 node now, 1 before: different Recover_A"
    without = Tree(Definition("Main", sequence(leaf(place("A", "box")))))
    (change,) = differences(with_it, without)
    assert change.sentence == "recovery has 0 nodes now, 1 before: gone Recover_A"


def test_nodes_that_are_arranged_otherwise_are_told_where_nothing_else_changed() -> None:
    one = Tree(Definition("Main", sequence(leaf(place("A", "box")))))
    other = Tree(Definition("Main", sequence(leaf(place("A", "box")), reactive=False)))
    (change,) = differences(one, other)
    assert change.sentence == "it is arranged otherwise: 2 nodes now, 2 before"
    renamed = Tree(Definition("Other", one.main.root))
    assert [each.sentence for each in differences(one, renamed)] == [
        "the trees do the same and are only written otherwise"
    ]
