"""A cell that is what its profile says, for its simulation, its recorder and those who play with it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from support_physical_cell import free_port, living_cell, witness
from support_processes import wait_until
from support_recorder import Refused, recording_cell

from learner.simulation.cell.camera import Noise
from pipelines.cli import main
from pipelines.network.question import ask
from pipelines.profile import Profile
from recorder.daemon import Options
from recorder.recording import read_header

SCENE = {
    "objects": {
        "A": {"size_m": [0.05, 0.05, 0.05], "symmetry": "cube"},
        "bin": {"size_m": [0.3, 0.3, 0.08], "symmetry": "box", "open": True},
    },
    "workspace_m": [[0.36, 0.60], [-0.36, 0.36]],
}
PROFILE = Profile("world", "flange", SCENE)
PORT = free_port()
Play = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module")
def session() -> Iterator[zenoh.Session]:
    with living_cell(PROFILE, seed=5, noise=Noise(0.0, 0.0), port=PORT) as session:
        yield session


@pytest.fixture
def play(session: zenoh.Session, capsys: pytest.CaptureFixture[str]) -> Play:
    """`treewright sim` with these words on the cell that lives; the truth after it."""

    def played(*words: str, code: int = 0) -> Any:
        assert main(["sim", "--cell", "c1", "--json", *words, "--connect", f"tcp/127.0.0.1:{PORT}"]) == code
        said = capsys.readouterr()
        return said.err if code else json.loads(said.out)

    return played


def test_the_simulated_cell_has_the_frames_and_shapes_of_its_profile(session: zenoh.Session) -> None:
    with witness(session) as seen:
        wait_until(lambda: seen.poses)
    transforms = seen.poses[-1].transforms
    assert {each.parent_frame_id for each in transforms} == {"world"}
    assert {each.child_frame_id for each in transforms} == {"A", "bin", "flange"}
    told = ask(session, "treewright/c1/sim/scene", {})
    assert (told["base_frame"], told["end_effector_frame"], told["scene"]) == ("world", "flange", SCENE)


def test_an_operator_leads_the_hand_by_commands(play: Play) -> None:
    play("reset", "--seed", "5")
    assert play("hand", "A")["poses"]["flange"]["position"] == pytest.approx(
        play("truth")["poses"]["A"]["position"], abs=0.002
    )
    assert play("grip", "closed")["held"] == "A"
    play("hand", "bin", "0", "0", "0.09")
    assert play("grip", "open")["held"] is None
    x, y, _ = play("hand", "world", "0.45", "-0.1", "0.3", "--turn", "90")["poses"]["flange"]["position"]
    assert (x, y) == pytest.approx((0.45, -0.1), abs=0.002)
    truth = play("truth")["poses"]
    assert truth["A"]["position"][:2] == pytest.approx(truth["bin"]["position"][:2], abs=0.06)


def test_objects_are_pulled_about_by_command_and_reset_starts_anew(play: Play) -> None:
    start = play("reset", "--seed", "6")["poses"]
    assert play("move", "A", "0.5", "0.2")["poses"]["A"]["position"][:2] == pytest.approx((0.5, 0.2), abs=1e-6)
    elsewhere = play("move", "A")["poses"]["A"]["position"]
    assert elsewhere[:2] != pytest.approx((0.5, 0.2), abs=0.01)
    assert play("reset", "--seed", "6")["poses"]["bin"] == start["bin"]
    assert play("reset")["poses"]["bin"] != start["bin"]


def test_what_is_taken_away_is_not_seen_until_it_is_put_somewhere(play: Play, session: zenoh.Session) -> None:
    play("reset", "--seed", "6")
    play("hand", "A")
    assert play("grip", "closed")["held"] == "A"
    truth = play("take", "A")
    assert (truth["away"], truth["held"], "A" in truth["poses"]) == (["A"], None, False)
    with witness(session) as seen:
        wait_until(lambda: len(seen.poses) > 3)
    assert {each.child_frame_id for each in seen.poses[-1].transforms} == {"bin", "flange"}
    play("grip", "open")
    truth = play("move", "A", "0.5", "0.0")
    assert truth["away"] == []
    assert truth["poses"]["A"]["position"] == pytest.approx((0.5, 0.0, 0.025), abs=0.002)
    play("hand", "A")
    assert play("grip", "closed")["held"] == "A"
    play("take", "bin")
    assert play("take", "A")["away"] == ["A", "bin"]
    assert play("reset")["away"] == []


def test_what_cannot_be_played_is_told_in_one_line(play: Play) -> None:
    assert play("hand", "C", code=1) == "treewright: the cell has no 'C'; it has world, A, bin, flange\n"
    assert "the hand stopped" in play("hand", "world", "2", "2", "0.2", code=1)
    assert "no object 'C'" in play("move", "C", code=1)
    assert "no object 'C'" in play("take", "C", code=1)
    with pytest.raises(SystemExit) as caught:
        play("move", "A", "0.5")
    assert caught.value.code == 2


def test_skills_know_the_base_frame_by_the_name_of_the_profile(session: zenoh.Session) -> None:
    ask(session, "treewright/c1/sim/reset", {"seed": 5})
    ports = {"object": "A", "position": [0.5, 0.0, 0.2], "orientation": [1, 0, 0, 0], "execution_id": "e1"}
    reply = ask(session, "treewright/c1/skills/Place", {**ports, "frame": "world"}, 60)
    assert "A" in reply["reason"]
    assert "frame" not in reply["reason"]
    with pytest.raises(Exception, match=r"no frame 'base' in this cell; it has world, A, bin"):
        ask(session, "treewright/c1/skills/Place", {**ports, "frame": "base"}, 60)


def test_a_recorder_with_a_profile_needs_to_be_told_task_and_user_alone(tmp_path: Path) -> None:
    with recording_cell(tmp_path, Options(cell=PROFILE.start())) as cell:
        cell.ask("start", {"task": "lift", "user": "anna", "objects": None, "unseen_ok": True})
        stopped = cell.ask("stop", {"outcome": "success"})
        told = read_header(Path(stopped["file"]))
        assert (told.objects, told.base_frame, told.end_effector_frame) == (("A", "bin"), "world", "flange")
        assert told.scene is not None
        assert json.loads(told.scene) == SCENE
        with pytest.raises(Refused, match="no poses are published"):
            cell.ask("start", {"task": "lift", "user": "anna"})
        cell.ask("start", {"task": "lift", "user": "anna", "objects": ["A"], "unseen_ok": True})
        assert read_header(Path(cell.ask("stop", {"outcome": "success"})["file"])).objects == ("A",)
