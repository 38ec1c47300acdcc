"""Import of YAML demonstrations: the recordings are those of any cell, and what is broken is named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from learner.errors import NameRefusedError
from learner.model import Pose
from learner.observation import observe
from pipelines.cli import main
from recorder.errors import ImportRefusedError
from recorder.imports.yaml_import import import_folder
from recorder.recording import read_recording

YUMI = Path("../shared/data/yumi_cube_in_box")


def put_step(file: Path, kind: str, tool: Pose, objects: dict[str, Pose]) -> None:
    """One action as the format has it: the end-effector in every frame."""
    poses = {"base": tool, **{name: pose.inverse() @ tool for name, pose in objects.items()}}
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(
        yaml.safe_dump(
            {
                "type": kind,
                "vec_pos": {name: list(pose.position) for name, pose in poses.items()},
                "vec_quat": {name: list(pose.quaternion_xyzw) for name, pose in poses.items()},
            }
        )
    )


CUBE, BOX = Pose((0.4, 0.1, 0.02), (0.0, 0.0, 0.6, 0.8)), Pose((0.6, -0.2, 0.0), (0.0, 0.0, -0.28, 0.96))
ABOVE_CUBE, ABOVE_BOX = Pose((0.4, 0.1, 0.03), (1.0, 0.0, 0.0, 0.0)), Pose((0.6, -0.2, 0.15), (1.0, 0.0, 0.0, 0.0))


@pytest.fixture
def source(tmp_path: Path) -> Path:
    folder = tmp_path / "demos"
    put_step(folder / "demo1" / "data_1.yaml", "pick", ABOVE_CUBE, {"A": CUBE, "box": BOX})
    put_step(folder / "demo1" / "data_2.yaml", "drop", ABOVE_BOX, {"A": Pose((0.6, -0.2, 0.14)), "box": BOX})
    (folder / "info.yaml").write_text(yaml.safe_dump({"default_frame": "base", "frames": ["A", "box", "base"]}))
    return folder


def test_objects_come_out_where_they_were(source: Path, tmp_path: Path) -> None:
    (file,) = import_folder(source, tmp_path / "recordings", "t", "u").imported
    pick, drop = observe(read_recording([file])).actions
    assert (pick.type, pick.object, drop.type, drop.object) == ("pick", "A", "drop", "A")
    assert np.allclose(pick.objects["A"].position, CUBE.position)
    assert np.allclose(pick.objects["A"].quaternion_xyzw, CUBE.quaternion_xyzw)
    assert np.allclose(drop.objects["box"].position, BOX.position)
    assert np.allclose(drop.end_effector.position, ABOVE_BOX.position)


def test_no_rest_pose_is_invented(source: Path, tmp_path: Path) -> None:
    put_step(source / "demo1" / "data_3.yaml", "pick", ABOVE_CUBE, {"A": CUBE, "box": BOX})
    (file,) = import_folder(source, tmp_path / "recordings", "t", "u").imported
    assert [action.rest_seen for action in observe(read_recording([file])).actions if action.rest] == [False]


def test_a_second_import_changes_nothing(source: Path, tmp_path: Path) -> None:
    first = import_folder(source, tmp_path / "recordings", "t", "u")
    content = first.imported[0].read_bytes()
    second = import_folder(source, tmp_path / "recordings", "t", "u")
    assert (second.imported, second.known) == ((), first.imported)
    assert first.imported[0].read_bytes() == content
    assert first.imported[0].parent == tmp_path / "recordings" / "imported"


def test_the_same_content_is_the_same_file_byte_for_byte(source: Path, tmp_path: Path) -> None:
    one, two = (import_folder(source, tmp_path / name, "t", "u").imported[0] for name in ("one", "two"))
    assert one.name == two.name
    assert one.read_bytes() == two.read_bytes()


def test_files_of_other_names_are_skipped_and_named(source: Path, tmp_path: Path) -> None:
    (source / "demo1" / "data_1_v2.yaml").write_text("type: pick")
    (skipped,) = import_folder(source, tmp_path / "recordings", "t", "u").skipped
    assert skipped.file == source / "demo1" / "data_1_v2.yaml"
    assert "not data_<K>.yaml" in skipped.reason


@pytest.mark.parametrize(
    ("file", "content", "sentence"),
    [
        ("info.yaml", None, "has no info.yaml"),
        ("info.yaml", "frames: [A", "it is not YAML"),
        ("info.yaml", "- A", "not a YAML mapping"),
        ("info.yaml", "frames: [A]", "needs a list `frames` and a `default_frame`"),
        ("info.yaml", "{frames: [base], default_frame: base}", "needs frames other than base"),
        ("info.yaml", "{frames: [../A, base], default_frame: base}", "object name '../A' is refused"),
        ("info.yaml", "{frames: [A, box, C, base], default_frame: base}", "no list of numbers for the frame C"),
        ("demo1/data_1.yaml", None, r"data_1\.yaml is missing"),
        ("demo1/data_2.yaml", "{type: throw}", "its type is 'throw'"),
        ("demo1/data_2.yaml", "{type: drop}", "needs `vec_pos` and `vec_quat`"),
        ("demo1/data_2.yaml", "{type: drop, vec_pos: {base: [1, 2, x]}, vec_quat: {}}", "no list of numbers"),
    ],
)
def test_a_broken_folder_is_refused_whole(
    source: Path, tmp_path: Path, file: str, content: str | None, sentence: str
) -> None:
    put_step(source / "demo2" / "data_1.yaml", "pick", ABOVE_CUBE, {"A": CUBE, "box": BOX})
    (source / file).unlink()
    if content is not None:
        (source / file).write_text(content)
    with pytest.raises(ImportRefusedError, match=sentence):
        import_folder(source, tmp_path / "recordings", "t", "u")
    assert not (tmp_path / "recordings").exists()


@pytest.mark.parametrize("numbers", ["[.nan, 0, 0]", "[.inf, 0, 0]", "[1, 2]", "[1, 2, 3, 4]"])
def test_a_pose_that_is_none_is_refused(source: Path, tmp_path: Path, numbers: str) -> None:
    data = yaml.safe_load((source / "demo1" / "data_2.yaml").read_text())
    data["vec_pos"]["A"] = yaml.safe_load(numbers)
    (source / "demo1" / "data_2.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ImportRefusedError, match="the pose in A is none"):
        import_folder(source, tmp_path / "recordings", "t", "u")


def test_a_bad_name_is_refused(source: Path, tmp_path: Path) -> None:
    with pytest.raises(NameRefusedError, match=r"task name '\.\./t'"):
        import_folder(source, tmp_path / "recordings", "../t", "u")


def test_the_command_says_what_became_of_every_file(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TREEWRIGHT_HOME", str(tmp_path / "home"))
    (source / "demo1" / "notes.txt").write_text("shaky")
    assert main(["import", str(source), "--task", "t", "--user", "u", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [Path(file).parent for file in report["imported"]] == [tmp_path / "home" / "recordings" / "imported"]
    assert [Path(entry["file"]).name for entry in report["skipped"]] == ["notes.txt"]
    assert main(["import", str(source / "demo1"), "--task", "t", "--user", "u"]) == 1
    assert "has no info.yaml" in capsys.readouterr().err


def test_demonstrations_of_a_real_yumi_are_imported(tmp_path: Path) -> None:
    if not YUMI.exists():
        pytest.skip(f"{YUMI} is not here")
    done = import_folder(YUMI, tmp_path, "cube_in_box", "u1")
    assert [skipped.file.name for skipped in done.skipped] == ["data_1_v2.yaml"]
    for file in done.imported:
        demonstration = observe(read_recording([file]))
        assert [(action.type, action.object) for action in demonstration.actions] == [("pick", "A"), ("drop", "A")]
        assert demonstration.actions[1].frames == ("marker_61",)
    assert len(done.imported) == 3
