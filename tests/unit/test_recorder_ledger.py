"""The loss ledger: whatever comes in whatever order, what is missing is counted, once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recorder.intake.account import Loss
from recorder.intake.ledger import Ledger
from recorder.teaching.feedback import gaps_near_actions

S, T = ("session", 1), ("session", 2)
NS = 1_000_000_000


def counting() -> Ledger:
    ledger = Ledger()
    ledger.arrived("/force", S, 0, 0)
    ledger.begin()
    return ledger


@given(st.lists(st.integers(1, 60), max_size=80))
def test_what_is_missing_is_what_never_arrived(numbers: list[int]) -> None:
    ledger = counting()
    for number in numbers:
        ledger.arrived("/force", S, number, number)
    missing = set(range(1, max(numbers, default=0) + 1)) - set(numbers)
    assert ledger.lost(["/force"]) == {"/force": len(missing)}


@given(st.lists(st.integers(1, 60), max_size=80))
def test_every_number_is_let_in_exactly_once(numbers: list[int]) -> None:
    ledger = counting()
    let_in = [number for number in numbers if ledger.arrived("/force", S, number, 0)]
    assert sorted(let_in) == sorted(set(numbers))


def test_numbers_begin_anew_after_the_last() -> None:
    ledger = Ledger()
    ledger.arrived("/force", S, 2**32 - 2, 0)
    ledger.begin()
    assert ledger.arrived("/force", S, 1, 0)
    assert ledger.lost() == {"/force": 2}
    assert ledger.arrived("/force", S, 2, 0)
    assert not ledger.arrived("/force", S, 1, 0)


def test_a_plain_publisher_makes_losses_unknowable() -> None:
    ledger = counting()
    ledger.arrived_unnumbered("/sound")
    assert ledger.lost(["/force", "/sound", "/never"]) == {"/force": 0, "/sound": None, "/never": None}


def test_what_was_missing_before_the_start_does_not_count_but_is_let_in() -> None:
    ledger = Ledger()
    ledger.arrived("/force", S, 0, 0)
    ledger.arrived("/force", S, 5, 0)
    ledger.begin()
    assert ledger.lost(["/force"]) == {"/force": 0}
    assert ledger.arrived("/force", S, 3, 0)
    assert not ledger.arrived("/force", S, 3, 0)


def test_what_a_cache_has_from_before_the_start_is_left_out() -> None:
    ledger = Ledger()
    ledger.heard("/force", S, 4, 0)
    ledger.begin()
    assert not ledger.arrived("/force", S, 3, 0, cached=True)
    assert ledger.arrived("/force", S, 6, 0, cached=True)
    assert ledger.arrived("/force", S, 5, 0, cached=True)
    assert ledger.lost(["/force"]) == {"/force": 0}


def test_what_is_missed_while_paused_does_not_count() -> None:
    ledger = counting()
    ledger.pause()
    ledger.arrived("/force", S, 10, 0)
    ledger.resume()
    ledger.arrived("/force", S, 13, 0)
    assert ledger.lost() == {"/force": 2}


def test_a_split_hands_over_what_may_still_come() -> None:
    ledger = counting()
    ledger.arrived("/force", S, 3, 0)
    ledger.arrived("/force", S, 6, 0)
    ledger.open_gaps[S][0].hopeless = True
    assert ledger.split(["/force"]).lost == {"/force": 2}
    assert ledger.lost(["/force"]) == {"/force": 2}
    ledger.arrived("/force", S, 4, 0)
    assert ledger.lost(["/force"]) == {"/force": 1}


def test_a_publisher_that_appears_during_the_recording_begins_at_0() -> None:
    ledger = Ledger()
    ledger.begin()
    ledger.arrived("/force", S, 7, 0)
    ledger.appeared("/force", S, 0)
    ledger.appeared("/force", T, 0)
    ledger.arrived("/force", T, 2, 0)
    assert ledger.lost() == {"/force": 9}
    ledger.began_late(S, 5)
    assert ledger.lost() == {"/force": 4}


def test_what_a_source_says_of_itself_does_not_shut_out_what_is_on_its_way() -> None:
    ledger = Ledger()
    ledger.heard("/force", S, 4, 0)
    ledger.begin()
    assert [ledger.arrived("/force", S, number, 0) for number in (3, 4, 4, 5)] == [True, True, False, True]
    assert ledger.lost(["/force"]) == {"/force": 0}
    ledger.heard("/force", S, 8, 0)
    assert ledger.lost() == {"/force": 3}


def test_any_number_of_gaps_is_counted_exactly_in_bounded_memory() -> None:
    ledger = counting()
    rng = np.random.default_rng(0)
    number = missing = 0
    for _ in range(5_000):
        step = int(rng.integers(2, 6))
        number += step
        missing += step - 1
        ledger.arrived("/force", S, number, 0)
    assert ledger.lost() == {"/force": missing}
    assert sum(len(gaps) for gaps in ledger.open_gaps.values()) <= 1_024


def test_refusals_count_whether_numbered_or_not() -> None:
    ledger = counting()
    for _ in range(3_000):
        ledger.refused("/force", S, 0)
        ledger.refused("/sound", None, 0)
    ledger.unwritten("/force", 5)
    ledger.arrived_unnumbered("/sound")
    assert ledger.refusals == {"/force": 3_005, "/sound": 3_000}
    assert ledger.lost() == {"/force": 3_005, "/sound": None}


@pytest.mark.parametrize(
    ("loss", "marked"),
    [
        (Loss("/poses", 3, 9 * NS, 10 * NS), True),
        (Loss("/gripper", 3, 10 * NS, 11 * NS), True),
        (Loss("/poses", 3, 2 * NS, 8 * NS), False),
        (Loss("/poses", 3, 13 * NS, 14 * NS), False),
        (Loss("/image", 3, 9 * NS, 11 * NS), False),
        (Loss("/action", 1, 90 * NS, 91 * NS), True),
    ],
)
def test_a_loss_marks_a_demonstration_where_it_may_have_falsified_an_action(loss: Loss, marked: bool) -> None:
    assert bool(gaps_near_actions([loss], [(10 * NS, "pick")])) == marked


@settings(max_examples=30)
@given(st.integers(1, 3000), st.integers(1, 3000), st.booleans(), st.data())
def test_a_publisher_that_is_started_again_begins_a_new_account(
    before: int, after: int, clock_back: bool, data: st.DataObject
) -> None:
    """Whatever is missing of either life is counted, also where the second life's clock is an hour behind."""
    second_life_ns = -3600 * NS if clock_back else 3600 * NS
    heard = sorted(data.draw(st.sets(st.integers(0, after - 1), min_size=1, max_size=5)))
    ledger = Ledger()
    ledger.begin()
    for number in range(before):
        ledger.arrived("/force", S, number, number)
    let_in = [ledger.arrived("/force", S, number, second_life_ns + number) for number in heard]
    overlooked = heard[0] >= before
    assert all(let_in)
    if not overlooked:
        assert ledger.take_restarts() == {"/force": 1}
        assert ledger.lost(["/force"]) == {"/force": heard[-1] + 1 - len(heard)}


@settings(max_examples=60)
@given(st.integers(2, 30), st.integers(1, 30), st.booleans(), st.data())
def test_the_answers_about_a_second_life_may_come_in_any_order(
    before: int, further: int, clock_back: bool, data: st.DataObject
) -> None:
    """It has come further than the first; its newest samples may be heard before the one that tells it is another."""
    begin_ns = -NS if clock_back else NS
    ledger = Ledger()
    ledger.begin()
    for number in range(before - 1):
        ledger.arrived("/force", S, number, number)
    ledger.arrived("/force", S, before, before)
    numbers = data.draw(st.permutations(range(before + further)))
    let_in = [number for number in numbers if ledger.arrived("/force", S, number, begin_ns + number, cached=True)]
    again = [ledger.arrived("/force", S, number, begin_ns + number, cached=True) for number in numbers]
    let_in += [number for number, new in zip(numbers, again, strict=True) if new]
    assert sorted(let_in) == list(range(before + further))
    assert ledger.take_restarts() == {"/force": 1}
    assert ledger.lost() == {"/force": 1}


def test_what_the_first_life_lost_stays_lost_after_the_second_began() -> None:
    ledger = counting()
    ledger.arrived("/force", S, 5, 5)
    assert ledger.arrived("/force", S, 0, 10)
    assert ledger.arrived("/force", S, 2, 12)
    assert ledger.lost() == {"/force": 4 + 1}
    assert ledger.open_gaps[S][0].count == 1


def test_a_sample_that_arrives_twice_is_no_restart() -> None:
    ledger = counting()
    for number in range(1, 5000):
        assert ledger.arrived("/force", S, number, number)
    assert not ledger.arrived("/force", S, 4999, 4999)
    assert not ledger.arrived("/force", S, 4500, 4500, cached=True)
    assert not ledger.arrived("/force", S, 3, 3, cached=True)
    assert not ledger.take_restarts()


def test_numbers_that_nobody_can_have_come_to_are_a_new_account_too() -> None:
    ledger = counting()
    assert ledger.arrived("/force", S, 2**31 - 5, 7)
    assert ledger.arrived("/force", S, 2**31 - 3, 9)
    assert ledger.lost() == {"/force": 1}


def test_refusals_of_any_number_of_topics_are_counted() -> None:
    ledger = counting()
    for number in range(20_000):
        ledger.refused(f"/key{number % 6000}", None, number)
    assert sum(ledger.refusals.values()) == 20_000
    assert len(ledger.refusals) == 6000
