"""The command line itself: which version it is, and what was probably meant."""

from __future__ import annotations

from importlib.metadata import version

import pytest

from learner.learning import METHODS
from learner.progress import heard_by, tell
from learner.simulation.scenarios import SCENARIOS
from pipelines.cli import COMMANDS, main
from pipelines.commands import learn, sim
from pipelines.commands.run import tell_of


def ended(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as end:
        main([*words])
    said = capsys.readouterr()
    return end.value.code, said.out, said.err


def test_it_tells_its_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert ended(capsys, "--version") == (0, f"treewright {version('treewright')}\n", "")


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("lern", "task"), "learn"),
        (("ingst",), "ingest"),
        (("store", "lst"), "list"),
        (("demos", "shw", "d1"), "show"),
        (("demonstrate", "--cell", "c", "pik"), "pick"),
    ],
)
def test_a_mistyped_word_is_answered_with_what_was_meant(
    words: tuple[str, ...], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = ended(capsys, *words)
    assert code == 2
    assert err.rstrip().endswith(f"; did you mean {meant}?")


def test_a_word_that_is_near_to_none_gets_the_list_alone(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = ended(capsys, "xyzzy")
    assert code == 2
    assert "did you mean" not in err


def test_the_help_names_every_command_and_every_button(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(COMMANDS) <= set(ended(capsys, "--help")[1].split())
    buttons = ended(capsys, "demonstrate", "--help")[1]
    for button in (
        "start",
        "pick",
        "place",
        "drop",
        "signal",
        "undo",
        "pause",
        "resume",
        "split",
        "stop",
        "discard",
        "status",
    ):
        assert f"    {button} " in buttons


def test_the_help_names_the_methods_and_the_scenarios_that_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(METHODS) <= set(ended(capsys, "learn", "--help")[1].replace(",", " ").split())
    assert tuple(METHODS) == learn.METHODS
    assert set(SCENARIOS) <= set(ended(capsys, "sim", "--help")[1].replace(",", " ").split())
    assert tuple(SCENARIOS) == sim.SCENARIOS


def test_a_mistyped_method_is_answered_with_what_was_meant(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = ended(capsys, "learn", "task", "--method", "papper")
    assert code == 2
    assert err.rstrip().endswith("; did you mean paper?")


def test_a_run_tells_what_it_does_and_why_it_goes_on() -> None:
    told: list[str] = []
    with heard_by(told.append):
        tell_of("start", {"action": "Pick A in A"})
        tell_of("answer", {"status": "failure", "reason": "A is out of reach"})
        tell_of("condition", {"holds": True})
        tell_of("success", {})
    assert told == ["Pick A in A", "going on after a failure: A is out of reach", "watching: the goal holds"]


def test_what_is_told_is_heard_within_the_block_alone() -> None:
    told: list[str] = []
    with heard_by(told.append):
        tell("one")
        with heard_by([].append):
            tell("two")
        tell("three")
    tell("four")
    assert told == ["one", "three"]
