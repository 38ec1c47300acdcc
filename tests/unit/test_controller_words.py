"""The small words of a controller: which tree was asked for, what an action is called, what a trace holds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from learner.errors import NameRefusedError
from learner.model.tree import Node
from pipelines.controller.controller import described
from pipelines.controller.trace import Trace
from pipelines.errors import CommandError
from pipelines.reference import Reference


@pytest.mark.parametrize(
    ("text", "reference"),
    [
        ("towers", Reference("towers")),
        ("towers@7", Reference("towers", version=7)),
        ("towers@production", Reference("towers", alias="production")),
        ("2-towers.v1@a1", Reference("2-towers.v1", alias="a1")),
    ],
)
def test_a_reference_reads_as_it_is_written(text: str, reference: Reference) -> None:
    assert Reference.parse(text) == reference
    assert str(reference) == text


@pytest.mark.parametrize("text", ["", "@7", "a/b", "..", "towers@", "towers@1.5", "towers@-1", "towers@7@8", "t@²"])
def test_a_reference_that_the_contract_refuses_is_refused(text: str) -> None:
    with pytest.raises(NameRefusedError):
        Reference.parse(text)


def test_versions_begin_at_one() -> None:
    with pytest.raises(CommandError, match="counted from 1"):
        Reference.parse("towers@0")


def test_an_action_is_described_in_few_words() -> None:
    ports = {"object": "A", "frame": "box", "position": (0.0, 0.0, 0.0), "orientation": (0.0, 0.0, 0.0, 1.0)}
    assert described(Node("Drop", tuple(sorted(ports.items())))) == "Drop A in box"
    assert described(Node("SetGripper", (("state", "open"),))) == "SetGripper open"


def test_every_line_of_a_trace_is_whole_as_soon_as_it_is_written(tmp_path: Path) -> None:
    with Trace(tmp_path / "traces" / "run.jsonl") as trace:
        trace.tick = 3
        trace.write("start", action="Pick A in A")
        (line,) = trace.path.read_text().splitlines()
    assert {**json.loads(line), "stamp_ns": 0} == {
        "stamp_ns": 0,
        "tick": 3,
        "event": "start",
        "action": "Pick A in A",
    }


def test_a_trace_is_never_written_over_another(tmp_path: Path) -> None:
    (tmp_path / "run.jsonl").write_text("")
    with pytest.raises(CommandError, match="cannot write the trace"), Trace(tmp_path / "run.jsonl"):
        pass
