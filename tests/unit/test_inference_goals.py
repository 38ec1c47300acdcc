"""Labels, goals and groups, questions, and who agrees, each by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from support_demonstrations import BASE, Put, Script, scattered, scripted

from learner.inference.chains import orders
from learner.inference.labels import label_check
from learner.inference.moves import NONE, moves_of
from learner.inference.parameters import InferenceParameters
from learner.inference.samples import Samples
from learner.inference.understanding import Understanding, understand
from learner.inference.users import agreement, understood_of, understood_without
from learner.model import Demonstration
from learner.regularities.questions import questions

PARAMETERS = InferenceParameters()
NAMES = ["A", "B", "box", "tray"]
A_IN_BOX, B_IN_BOX = Put("A", "box", (-0.05, 0.0, 0.02)), Put("B", "box", (0.05, 0.0, 0.02))
A_ON_TRAY = Put("A", "tray", (0.0, 0.0, 0.03))


def shown(scripts: Sequence[Script], users: Sequence[str] = ("u",)) -> list[Demonstration]:
    """A demonstration of each script, from a start of its own; users take turns."""
    rng = np.random.default_rng(8)
    starts = [scattered(NAMES, rng) for _ in scripts]
    turns = enumerate(zip(scripts, starts, strict=True))
    return [scripted(start, script, f"d{n}", user=users[n % len(users)], rng=rng) for n, (script, start) in turns]


def understood(scripts: Sequence[Script], users: Sequence[str] = ("u",)) -> Understanding:
    return understand(shown(scripts, users), PARAMETERS)


def goals(found: Understanding) -> list[tuple[tuple[int, ...], set[tuple[str, str]]]]:
    return [(group.demonstrations, {(t.object, t.frame) for t in group.goal}) for group in found.groups]


# Labels


@pytest.mark.parametrize(
    ("type_", "fall_m", "spread_m", "on_top", "label"),
    [
        ("place", 0.0, 0.003, False, "place"),
        ("drop", 0.0, 0.003, False, "place"),
        ("place", 0.08, 0.003, False, "drop"),
        ("place", 0.02, 0.06, False, "place"),
        ("drop", 0.08, 0.003, True, "place"),
        ("drop", 0.02, 0.03, False, "drop"),
    ],
)
def test_height_and_spread_tell_the_label(type_: str, fall_m: float, spread_m: float, on_top: bool, label: str) -> None:
    item = Put("A", "box", (0.0, 0.0, 0.02), type_, fall_m)  # type: ignore[arg-type]  # both are types of a release
    samples = Samples.of(shown([[item]] * 3))
    check = label_check(samples[samples.rest_known], spread_m, on_top, PARAMETERS)
    assert (check.type, check.chosen, check.corrected) == (label, type_, label != type_)


def test_a_person_who_relabelled_is_right() -> None:
    demonstrations = shown([[Put("A", "box", (0.0, 0.0, 0.02), "place", 0.2)]] * 3)
    pick, place = demonstrations[1].actions
    demonstrations[1] = replace(demonstrations[1], actions=(pick, replace(place, relabelled=True)))
    samples = Samples.of(demonstrations)
    assert label_check(samples[samples.rest_known], 0.2, False, PARAMETERS).type == "place"


# Moves


def test_a_pick_that_ends_a_demonstration_has_no_release_and_others_have_the_next_action() -> None:
    from support_demonstrations import Take

    moves, left_out = moves_of(Samples.of(shown([[A_IN_BOX, Take("B")], [B_IN_BOX]])), PARAMETERS)
    assert len(left_out.moves) == 0
    assert moves.object.tolist() == ["A", "B", "B"]
    assert moves.demonstration.tolist() == [0, 0, 1]
    assert (moves.release == NONE).tolist() == [False, True, False]


def test_what_is_moved_again_at_once_counts_once_and_is_told() -> None:
    moves, left_out = moves_of(Samples.of(shown([[A_ON_TRAY, A_IN_BOX, B_IN_BOX]])), PARAMETERS)
    assert moves.object.tolist() == ["A", "B"]
    assert "demonstration d0, action 0: A was moved again at once" in left_out.sentence(0)


# Goals


def test_demonstrations_with_one_goal_are_one_group_in_whatever_order_they_reach_it() -> None:
    found = understood([[A_IN_BOX, B_IN_BOX], [B_IN_BOX, A_IN_BOX]] * 2)
    assert goals(found) == [((0, 1, 2, 3), {("A", "box"), ("B", "box")})]


def test_a_demonstration_of_a_part_joins_the_whole_and_is_told() -> None:
    found = understood([[A_IN_BOX, B_IN_BOX]] * 4 + [[A_IN_BOX]])
    assert goals(found) == [((0, 1, 2, 3, 4), {("A", "box"), ("B", "box")})]
    assert found.groups[0].notes == ("demonstration d4 did not place B; the goal of the others stands",)


def test_two_goals_are_two_groups_the_larger_first() -> None:
    found = understood([[A_IN_BOX]] * 3 + [[A_ON_TRAY]] * 4)
    assert goals(found) == [((3, 4, 5, 6), {("A", "tray")}), ((0, 1, 2), {("A", "box")})]


def test_only_orders_that_nobody_reverses_are_kept() -> None:
    assert orders(["abc", "acb"]) == {("a", "b"), ("a", "c")}
    assert orders(["ab", "ba"]) == orders([]) == set()


# Questions


def test_a_sure_learner_asks_nothing_and_one_with_too_few_demonstrations_asks_for_more() -> None:
    sure = understood([[A_IN_BOX]] * 4)
    assert questions(sure.demonstrations, sure.targets, PARAMETERS) == []
    few = understood([[A_IN_BOX]] * 2)
    (question,) = questions(few.demonstrations, few.targets, PARAMETERS)
    assert question["frame"] == BASE
    assert "show 1 more" in question["sentence"]


def test_the_least_certain_action_is_asked_about_first() -> None:
    found = understood([[A_IN_BOX, B_IN_BOX]] * 4)
    unsure = [replace(t, frames={"box": c, "tray": 1 - c}) for t, c in zip(found.targets, (0.8, 0.6), strict=True)]
    asked = questions(found.demonstrations, unsure, PARAMETERS)
    assert [question["action"] for question in asked] == ["place B", "place A"]
    assert asked[0]["show"] == "move tray, leave box"


# Users


def test_leaving_a_user_out_is_understanding_the_others_alone() -> None:
    demonstrations = shown([[A_IN_BOX, B_IN_BOX]] * 9, ("u", "v", "w"))
    found = understand(demonstrations, PARAMETERS)
    for user, without in understood_without(found).items():
        assert without
        alone = understand([each for each in demonstrations if each.user != user], PARAMETERS)
        assert without.targets == alone.targets
        assert without.groups == alone.groups
        assert without.meaning == found.meaning


def test_a_user_who_puts_something_elsewhere_is_named() -> None:
    scripts = [[B_IN_BOX, A_ON_TRAY if number % 4 == 3 else A_IN_BOX] for number in range(16)]
    found = understood(scripts, ("u", "v", "w", "x"))
    told = {entry["user"]: entry for entry in agreement(found, understood_without(found))}
    assert {user: entry["differs"] for user, entry in told.items()} == {"u": [], "v": [], "w": [], "x": ["A"]}
    assert told["x"]["sentence"] == "user x puts A elsewhere than the others"
    assert told["u"]["demonstrations"] == 4


def test_of_a_single_user_and_of_too_few_others_nothing_is_told() -> None:
    assert understood_without(understood([[A_IN_BOX]] * 4)) == {}
    assert understood_without(understood([[A_IN_BOX]] * 4, ("u", "v"))) == {"u": None, "v": None}


def test_demonstrations_that_move_nothing_mean_nothing() -> None:
    found = understood([[A_IN_BOX], [A_IN_BOX], [A_IN_BOX], []])
    assert understood_of(np.array([False, False, False, True]), found) is None
