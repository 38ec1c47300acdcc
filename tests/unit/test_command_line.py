"""The command line itself: which version it is, and what was probably meant."""

from __future__ import annotations

from importlib.metadata import version

import pytest

from pipelines.cli import COMMANDS, main


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
