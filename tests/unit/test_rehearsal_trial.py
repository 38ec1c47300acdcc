"""The trial before publishing, and the replay with the arm in it: who is run, what is published, what is said."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS
from support_demonstrations import Put, at, repeated, scripted

from learner.learned import Learned
from learner.learning import learn
from learner.model import Demonstration, ObjectShape, Scene
from learner.rehearsal import beside, trial
from learner.rehearsal.arm_replay import Replay, replay
from learner.rehearsal.goal import goals_of
from learner.rehearsal.rehearsal import Judgement, RolloutResult
from learner.rehearsal.rollouts import Rollout
from learner.rehearsal.share import Share
from learner.rehearsal.stage import Stage
from learner.simulation.arena import Aftermath
from learner.simulation.failure import Failure
from learner.simulation.kinematic_world import Attempt, Faults
from pipelines.steps.gate import untried


@cache
def demonstrations() -> tuple[Demonstration, ...]:
    shown = demonstrated(SCENARIOS["object_in_box"], 3, 1000)
    return tuple(sorted(shown, key=lambda demonstration: demonstration.demonstration_id))


@cache
def learned() -> Learned:
    return learn(demonstrations())


def run(judgement: Judgement, *failures: tuple[str, Failure]) -> RolloutResult:
    attempts = tuple(
        Attempt(kind, "A", "box", step, failure, ended=True) for step, (kind, failure) in enumerate(failures)
    )
    return RolloutResult(Rollout("d1", {}, "replay"), judgement, Aftermath({}, {}, None, attempts, Faults()))


MISSED = ("Pick", Failure("missed", "A"))
FAILED = run("no progress", MISSED)
OUT_OF_REACH = run("no progress", ("Place", Failure("out of reach")), ("Place", Failure("out of reach")), MISSED)
HAND_DOES_NOT_FIT = run("too many actions", ("Pick", Failure("contact", with_="B")))
MET_WHILE_PLACING = run("no progress", ("Place", Failure("contact", with_="B")))
DONE = run("done", MISSED)


@pytest.mark.parametrize("result", [OUT_OF_REACH, HAND_DOES_NOT_FIT])
def test_what_the_simulated_arm_cannot_do_is_no_fault_of_the_tree(result: RolloutResult) -> None:
    assert Replay((result,)).failures == []
    assert not Replay((result,)).failed


@pytest.mark.parametrize("result", [FAILED, MET_WHILE_PLACING, run("false success")])
def test_a_replay_has_failed_where_every_run_was_failed_by_the_tree(result: RolloutResult) -> None:
    assert Replay((result, result)).failed
    assert not Replay((result, DONE)).failed
    assert not Replay((result, OUT_OF_REACH)).failed
    assert not Replay(reason="no run").failed


def test_a_replay_is_told_run_by_run() -> None:
    assert Replay((DONE, FAILED)).to_data()["runs"] == [
        {"demonstration_id": "d1", "verdict": "done", "actions": 1, "contacts": 0, "sentence": None},
        {"demonstration_id": "d1", "verdict": "no progress", "actions": 1, "contacts": 0, "sentence": str(FAILED)},
    ]


def replayed(stage: Stage) -> Replay:
    draft = learned().draft
    assert draft
    return replay(learned().tree, stage, lambda moved: goals_of(draft.understood.groups, draft.placements, moved))


def test_without_shapes_starts_or_reach_there_is_no_replay_but_the_reason() -> None:
    nowhere, far = Stage(demonstrations()), Stage(demonstrations())
    nowhere.starts = []
    apart = {"A": 0.0, "box": 3.0}
    far.starts = [replace(start, spots={n: replace(s, x=s.x + apart[n]) for n, s in start.spots.items()})
                  for start in far.starts]  # fmt: skip
    points = Stage(repeated(["A", "box"], [[Put("A", "box", (0.0, 0.0, 0.0))]] * 3))
    reasons = {
        "no demonstration tells the shapes": points,
        "the stage reproduces no": nowhere,
        "no demonstration fits": far,
    }
    for reason, stage in reasons.items():
        found = replayed(stage)
        assert (found.results, str(found.reason).startswith(reason)) == ((), True)


def tried(monkeypatch: pytest.MonkeyPatch, found: Replay) -> Learned:
    monkeypatch.setattr(trial, "replay", lambda *_: found)
    return trial.rehearse_and_repair(learned(), demonstrations())


def test_a_tree_whose_replays_all_fail_is_not_for_use_and_the_note_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    result = tried(monkeypatch, Replay((FAILED,)))
    assert result.certificate["counterexample"] == f"replayed {FAILED}"
    assert f"replay: {FAILED}" in result.notes
    assert result.report["replay"] == Replay((FAILED,)).to_data()


def test_one_replay_that_is_done_suffices(monkeypatch: pytest.MonkeyPatch) -> None:
    result = tried(monkeypatch, Replay((FAILED, DONE)))
    assert result.certificate["counterexample"] is None
    assert f"replay: {FAILED}" in result.notes


def test_what_is_tried_beside_comes_to_the_same_as_what_is_tried_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beside, "_may_copy", lambda: True)
    there = trial.rehearse_and_repair(learned(), demonstrations())
    monkeypatch.setattr(beside, "_may_copy", lambda: False)
    here = trial.rehearse_and_repair(learned(), demonstrations())
    assert there.tree == here.tree
    assert (there.report, there.notes, there.certificate) == (here.report, here.notes, here.certificate)


def test_of_two_trees_the_proven_one_is_better_then_the_one_that_replays_then_the_one_that_rehearses() -> None:
    result = tried_of(True, Replay((DONE,)), Share(9, 10))
    assert result > tried_of(False, Replay((DONE,)), Share(10, 10))
    assert result > tried_of(True, Replay((DONE, FAILED)), Share(10, 10))
    assert result > tried_of(True, Replay((DONE,)), Share(8, 10))


def tried_of(proven: bool, found: Replay, share: Share) -> tuple[bool, int, float]:
    draft, stage = learned().draft, Stage(demonstrations())
    assert draft
    results = (DONE,) * share.done + (FAILED,) * (share.of - share.done)
    candidate = trial.Candidate(learned().tree, trial.NOTHING, trial.Rehearsal(stage, results))
    sure = trial._certificate(learned(), learned().tree, stage.base)
    certificate = sure if proven else replace(sure, counterexample="some state")
    return trial._Tried(candidate, certificate, found).better


def test_a_user_whom_the_others_tree_reproduces_in_less_than_half_is_named_once() -> None:
    users = [{"user": name, "sentence": "said already" if name == "u4" else None} for name in ("u1", "u2", "u3", "u4")]
    shares = {"u1": Share(1, 3), "u2": Share(2, 4), "u3": None, "u4": Share(0, 3)}
    assert trial._unlike(users, shares) == ["the tree of the others does what user u1 did from 1 of 3 starts"]


def test_a_stage_is_the_same_for_the_replay_wherever_it_stands_on_the_table() -> None:
    stage = Stage(demonstrations())
    moved = stage.moved(0.1, -0.2)
    here, there = (each.world(each.starts[0].spots, np.random.default_rng(0)) for each in (stage, moved))
    for name in here.table.spots:
        a, b = here.spot(name), there.spot(name)
        assert (b.x - a.x, b.y - a.y, b.z - a.z) == pytest.approx((0.1, -0.2, 0.0))


FIXTURE = ObjectShape((0.2, 0.2, 0.06))
PART = ObjectShape((0.05, 0.05, 0.04))


@cache
def in_a_pocket() -> tuple[Learned, Learned]:
    """Learned without and with a rehearsal: a part that lies 20 mm above where the floor of a box would be."""
    scene = Scene({"A": PART, "F": FIXTURE}, ((0.15, 0.85), (-0.55, 0.55)))
    rng, found = np.random.default_rng(3), []
    for number in range(4):
        start = {"A": at(0.4, 0.3 - 0.03 * number, z=0.02), "F": at(0.5, -0.2, z=0.03, yaw=0.3 * number)}
        script = [Put("A", "F", (0.04, 0.03, 0.015), yaw=float(rng.uniform(-3, 3)))]
        found.append(scripted(start, script, f"d{number}", rng=rng, scene=scene))
    return learn(found), learn(found, rehearsed=True)


def test_a_rehearsal_never_widens_a_radius() -> None:
    before, after = in_a_pocket()
    assert after.tree == before.tree
    assert after.report["rehearsal"]["repairs"] == []


def test_what_cannot_be_simulated_is_left_out_and_told() -> None:
    _, after = in_a_pocket()
    rehearsal, replayed_ = after.report["rehearsal"], after.report["replay"]
    (note,) = (note for note in after.notes if note.startswith("left out of the rehearsal"))
    assert (rehearsal["rollouts"], replayed_["runs"]) == (0, [])
    assert re.search(r"4 demonstrations: A comes to rest (19|20|21) mm lower in simulation than it did each time", note)
    assert rehearsal["reason"] in note
    assert "F may have a pocket or a rim" in rehearsal["reason"]
    (told, *_) = untried(after)
    assert told == f"it was not rehearsed: {rehearsal['reason']}"
