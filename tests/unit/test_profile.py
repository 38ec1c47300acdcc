"""The profile of a cell: what it may say, what is refused, and what is made of it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from learner.simulation.scenarios import SCENARIOS, sample_start
from pipelines.commands import demonstrate, panel, world
from pipelines.errors import CommandError
from pipelines.home import Home
from pipelines.profile import Profile, ProfileError, frames_and_scene, profile_of, read_profile, written
from pipelines.simulated_cell.table import profile_of_scenario, scenario_of

KITTING = """
base_frame: world
end_effector_frame: flange
objects:
  A: {size_m: [0.05, 0.05, 0.05], symmetry: cube, kind: cube}
  tray: {size_m: [0.3, 0.3, 0.03], open: true, fixed: true}
  wall: {size_m: [0.05, 0.05, 0.2], fixed: true}
  plate: {size_m: [0.2, 0.2, 0.02], symmetry: box}
workspace_m: [[0.40, 0.60], [-0.2, 0.3]]
accuracy_m: 0.003
"""


def read(folder: Path, text: str) -> Profile:
    file = folder / "cell.yaml"
    file.write_text(text)
    return read_profile(file)


def test_a_profile_says_what_a_start_needs_of_the_cell(tmp_path: Path) -> None:
    start = read(tmp_path, KITTING).start()
    assert start["objects"] == ["A", "tray", "wall", "plate"]
    assert (start["base_frame"], start["end_effector_frame"]) == ("world", "flange")
    assert start["scene"]["objects"]["tray"] == {"size_m": [0.3, 0.3, 0.03], "open": True, "fixed": True}
    assert (start["scene"]["workspace_m"], start["scene"]["accuracy_m"]) == ([[0.40, 0.60], [-0.2, 0.3]], 0.003)


def test_only_objects_must_be_there(tmp_path: Path) -> None:
    profile = read(tmp_path, "objects: {A: {size_m: [0.05, 0.05, 0.05]}}")
    assert (profile.base_frame, profile.end_effector_frame, profile.objects) == ("base", "tool0", ("A",))


@pytest.mark.parametrize("scenario", sorted(SCENARIOS))
def test_what_a_scenario_shows_can_be_written_and_read_again(scenario: str, tmp_path: Path) -> None:
    profile = profile_of_scenario(SCENARIOS[scenario])
    assert read(tmp_path, written(profile)) == profile
    bodies = scenario_of(profile).bodies
    assert {name: body.wall_m is None for name, body in bodies.items()} == {
        name: body.wall_m is None for name, body in SCENARIOS[scenario].bodies.items()
    }


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "a profile is a mapping, not 'None'"),
        ("- A", "a profile is a mapping"),
        ("objects: [A", "it is no YAML"),
        ("objects: {}", "it names no objects"),
        ("objects: [A, B]", "it names no objects"),
        ("object: {A: {size_m: [1, 1, 1]}}", "a profile has no 'object'; it may have base_frame"),
        ("objects: {A: {size: [1, 1, 1]}}", "the object A has no 'size'; it may have size_m"),
        ("objects: {A: [1, 1, 1]}", "the object A is a mapping"),
        ("objects: {A: {}}", "size_m of A is a list of three lengths in metres, not None"),
        ("objects: {A: {size_m: 0.05}}", "size_m of A is a list of three lengths in metres"),
        ("objects: {A: {size_m: [1, 1, -1]}}", "the size of A is not three positive lengths"),
        ("objects: {A: {size_m: [1, 1, 1], symmetry: round}}", "the symmetry of A is 'round'"),
        ("objects: {A: {size_m: [1, 1, 1], open: maybe}}", "whether A is open is said by true or false, not 'maybe'"),
        ("objects: {A: {size_m: [1, 1, 1], kind: 7}}", "kind name '7' is refused"),
        ("objects: {7: {size_m: [1, 1, 1]}}", "the name 7 is no text to YAML; write it in quotes"),
        ("objects: {'a/b': {size_m: [1, 1, 1]}}", "object name 'a/b' is refused"),
        ("objects: {none: {size_m: [1, 1, 1]}}", "object name 'none' is refused"),
        ("base_frame: ../x\nobjects: {A: {size_m: [1, 1, 1]}}", "frame name '../x' is refused"),
        ("base_frame: A\nobjects: {A: {size_m: [1, 1, 1]}}", "need names of their own"),
        ("workspace_m: [[1, 0], [0, 1]]\nobjects: {A: {size_m: [1, 1, 1]}}", "the workspace is empty"),
    ],
)
def test_what_is_no_profile_is_refused_with_the_file_and_what_is_wrong(
    text: str, sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(ProfileError) as refused:
        read(tmp_path, text)
    assert str(tmp_path / "cell.yaml") in str(refused.value)
    assert sentence in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_cell_has_the_profile_below_the_data_root_unless_another_is_named(tmp_path: Path) -> None:
    home = Home(tmp_path / "home")
    assert profile_of("bench", home) is None
    home.cells.mkdir(parents=True)
    (home.cells / "bench.yaml").write_text(KITTING)
    (tmp_path / "other.yaml").write_text("objects: {B: {size_m: [0.05, 0.05, 0.05]}}")
    found, named = profile_of("bench", home), profile_of("bench", home, tmp_path / "other.yaml")
    assert found is not None
    assert named is not None
    assert (found.objects[0], named.objects) == ("A", ("B",))
    with pytest.raises(ProfileError, match=r"gone\.yaml is refused: No such file"):
        profile_of("bench", home, tmp_path / "gone.yaml")


def test_the_simulated_table_goes_by_what_the_profile_says(tmp_path: Path) -> None:
    scenario = scenario_of(read(tmp_path, KITTING))
    graspable = {name for name, body in scenario.bodies.items() if body.graspable}
    assert graspable == {"A"}
    assert {name for name, body in scenario.bodies.items() if body.wall_m} == {"tray"}
    small = scenario_of(
        read(tmp_path, "objects: {A: {size_m: [0.05, 0.05, 0.05]}}\nworkspace_m: [[0.4, 0.5], [0, 0.1]]")
    )
    for seed in range(20):
        x, y, _ = sample_start(small, np.random.default_rng(seed))["A"].position
        assert 0.4 <= x <= 0.5
        assert 0.0 <= y <= 0.1
    with pytest.raises(CommandError, match="no object of a simulated cell is called tool0"):
        scenario_of(read(tmp_path, "end_effector_frame: hand\nobjects: {tool0: {size_m: [0.05, 0.05, 0.05]}}"))


def request(home: Path, monkeypatch: pytest.MonkeyPatch, *words: str) -> dict[str, Any]:
    """What `demonstrate start` with these words asks of the recorder."""
    monkeypatch.setenv("TREEWRIGHT_HOME", str(home))
    parser = argparse.ArgumentParser()
    demonstrate.add_arguments(parser)
    return demonstrate.request_of(parser.parse_args(["--cell", "bench", "start", "--task", "t", "--user", "u", *words]))


def test_a_start_takes_from_the_profile_what_is_not_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cells").mkdir()
    (tmp_path / "cells" / "bench.yaml").write_text(KITTING)
    asked = request(tmp_path, monkeypatch)
    assert asked == {"task": "t", "user": "u", **read(tmp_path, KITTING).start()}
    asked = request(tmp_path, monkeypatch, "--objects", "A,tray", "--base-frame", "map")
    assert (asked["objects"], asked["base_frame"], asked["end_effector_frame"]) == (["A", "tray"], "map", "flange")


def test_a_start_without_a_profile_leaves_the_cell_to_the_recorder_unless_objects_are_typed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert request(tmp_path, monkeypatch) == {"task": "t", "user": "u"}
    asked = request(tmp_path, monkeypatch, "--objects", "A", "B")
    frames = {"base_frame": "base", "end_effector_frame": "tool0"}
    assert asked == {"task": "t", "user": "u", "objects": ["A", "B"], **frames}


@pytest.mark.parametrize("command", [panel, world])
def test_a_command_knows_frames_and_shapes_by_the_profile_unless_they_are_typed(command: Any, tmp_path: Path) -> None:
    def known(*words: str) -> Any:
        parser = argparse.ArgumentParser()
        command.add_arguments(parser)
        return frames_and_scene(parser.parse_args(["--cell", "bench", *words]), Home(tmp_path))

    assert known() == ("base", "tool0", None)
    (tmp_path / "cells").mkdir()
    (tmp_path / "cells" / "bench.yaml").write_text(KITTING)
    base, hand, scene = known()
    assert (base, hand, scene.objects["tray"].open) == ("world", "flange", True)
    base, hand, scene = known("--base-frame", "map", "--scene", '{"objects": {}}')
    assert (base, hand, dict(scene.objects)) == ("map", "flange", {})
    for text in ("[", "{", '{"objects": 7}'):
        with pytest.raises(CommandError, match="scene"):
            known("--scene", text)
