"""A value that an option cannot have is wrong usage, whatever the command and the option."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import lru_cache

import pytest

from pipelines.cli import COMMANDS, _parser, main


def actions(
    parser: argparse.ArgumentParser, words: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], argparse.Action]]:
    """Every option that takes a value, with the words before it."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, below in action.choices.items():
                yield from actions(below, (*words, name))
        elif action.option_strings and action.type is not None:
            yield words, action


parser_of = lru_cache(_parser)


def chosen(command: str) -> argparse.ArgumentParser:
    return next(
        action.choices[command]
        for action in parser_of(command)._actions
        if isinstance(action, argparse._SubParsersAction)
    )


def takes_numbers(action: argparse.Action) -> bool:
    assert callable(action.type)
    return action.type in (int, float) or action.type.__module__ == "pipelines.options"


NUMERIC = [
    (words, action.option_strings[0])
    for command in COMMANDS
    for words, action in actions(chosen(command), (command,))
    if takes_numbers(action)
]


def test_the_numeric_options_are_found() -> None:
    options = {option for _, option in NUMERIC}
    assert options >= {"--buffer-mb", "--split-s", "--split-mb", "--pre-roll", "--timeout", "--stamp-ns", "--rate",
                       "--loop", "--seed", "--speed", "--period", "--prefect-port"}  # fmt: skip


VALUES = ("nan", "inf", "-inf", "-100", "", "x", "1e400", "9" * 5000, "٣", "1_0x", "0x10")


@pytest.mark.parametrize(("words", "option"), NUMERIC)
def test_what_is_no_number_for_an_option_is_wrong_usage(
    words: tuple[str, ...], option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for value in VALUES:
        with pytest.raises(SystemExit) as ended:
            parser_of(words[0]).parse_args([*words, f"{option}={value}"])
        assert ended.value.code == 2
        assert f"{option}: {value!r}"[:60] in capsys.readouterr().err


@pytest.mark.parametrize(("option", "value"), [("--split-s", "0"), ("--split-mb", "0"), ("--buffer-mb", "0"),
                                               ("--buffer-mb", "1e30"), ("--pre-roll", "1e9")])  # fmt: skip
def test_a_recorder_takes_no_size_that_cannot_work(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["record", "--cell", "c", option, value])
    assert ended.value.code == 2
    assert option in capsys.readouterr().err
