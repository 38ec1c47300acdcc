"""The numbers of the method stand in one place, count as they are handed in, and are told by the manifest."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS

import learner
from learner.inference.understanding import understand
from learner.learned import Learned
from learner.learning import learn
from learner.model import Demonstration
from learner.parameters import Parameters
from learner.planning.draft import Draft

LEARNER = Path(learner.__file__).parent
IN_PARAMETERS = ("planning", "proof")
NO_THRESHOLDS = {0.0, 0.5, 1.0, 1e-9}
"""Nothing, a half, a whole, and what keeps from dividing by zero."""
PARAMETERS = Parameters()


@pytest.fixture(scope="module")
def board() -> list[Demonstration]:
    return demonstrated(SCENARIOS["board"], 3, 5)


@pytest.mark.parametrize("folder", IN_PARAMETERS)
def test_no_threshold_stands_outside_the_parameters_of_its_folder(folder: str) -> None:
    strays = {
        f"{file.name}:{node.lineno}: {node.value}"
        for file in (LEARNER / folder).glob("*.py")
        if file.name != "parameters.py"
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value not in NO_THRESHOLDS
    }
    assert strays == set()


def test_every_folder_with_parameters_is_among_those_that_the_manifest_tells() -> None:
    folders = {file.parent.name for file in LEARNER.glob("*/parameters.py")}
    assert set(PARAMETERS.to_data()) == folders
    assert json.loads(json.dumps(PARAMETERS.to_data(), allow_nan=False)).keys() == folders


@pytest.mark.parametrize(
    "changed",
    [
        {"place_radius_m": 0.021},
        {"means": {"outlying": 1.0, "outlying_m": 0.0}},
    ],
    ids=str,
)
def test_a_number_of_the_planning_that_is_handed_in_changes_the_tree(
    board: list[Demonstration], changed: dict[str, Any]
) -> None:
    understood = understand(board, PARAMETERS.inference)
    usual = PARAMETERS.planning
    inner = {key: replace(getattr(usual, key), **value) if isinstance(value, dict) else value
             for key, value in changed.items()}  # fmt: skip
    assert Draft(understood, replace(usual, **inner), {}).tree() != Draft(understood, usual, {}).tree()


def test_a_number_of_the_proof_that_is_handed_in_changes_the_certificate(board: list[Demonstration]) -> None:
    few = replace(PARAMETERS, proof=replace(PARAMETERS.proof, exhaustive=100, sampled=50))
    whole, some = learn(board).certificate, learn(board, few).certificate
    assert whole is not None
    assert some is not None
    assert (whole["exhaustive"], some["exhaustive"], some["states"]) == (True, False, 50)


def test_the_prover_stacks_as_high_as_the_planner_takes_down(board: list[Demonstration]) -> None:
    low = replace(PARAMETERS.planning, recovery=replace(PARAMETERS.planning.recovery, levels=1))
    learned = learn(board, replace(PARAMETERS, planning=low))
    assert learned.certificate is not None
    assert learned.certificate["left_out"] == "piles of more than 2 objects"


def test_what_was_learned_says_by_which_numbers(board: list[Demonstration]) -> None:
    wanted = replace(PARAMETERS, planning=replace(PARAMETERS.planning, seen_m=0.002))
    assert [learn(board, wanted, method).parameters for method in ("treewright", "paper")] == [wanted, wanted]


@pytest.fixture(scope="module")
def usual(board: list[Demonstration]) -> Learned:
    return learn(board, PARAMETERS, rehearsed=True)


@pytest.mark.parametrize(
    ("group", "changed"),
    [
        ("rollouts", {"shown": 1}),
        ("rollouts", {"kinds": {"taken": 1}}),
        ("judging", {"patience": 0, "aside": 0}),
        ("replay", {"replays": 1}),
        ("stage", {"placed_m": -1.0}),
    ],
)
def test_a_number_of_the_rehearsal_that_is_handed_in_changes_what_it_finds(
    board: list[Demonstration], usual: Learned, group: str, changed: dict[str, Any]
) -> None:
    rehearsal = replace(PARAMETERS.rehearsal, **{group: replace(getattr(PARAMETERS.rehearsal, group), **changed)})
    other = learn(board, replace(PARAMETERS, rehearsal=rehearsal), rehearsed=True)
    told = ("rehearsal", "replay")
    assert [usual.report[what] for what in told] != [other.report[what] for what in told]
    assert other.parameters.to_data()["rehearsal"][group] != usual.parameters.to_data()["rehearsal"][group]
