"""Files as an operating system admits them: any name, and what is no file at all; the rest goes on."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path

import pytest
from support_recordings import object_in_box

from pipelines.cli import main

NAMES = [b"new\nline.mcap", b"bad\xff\xfe.mcap", b" -x.mcap", b"\xe2\x80\xae.mcap", b"a'b\"c.mcap", b"%s{0}.mcap"]


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TREEWRIGHT_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    capsys.readouterr()
    code = main([*words])
    said = capsys.readouterr()
    assert "defect" not in said.err
    said.out.encode()
    said.err.encode()
    return code, said.out, said.err


def test_any_name_is_ingested_and_found_known(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number, name in enumerate(NAMES):
        object_in_box(number).write(tmp_path / os.fsdecode(name))
    files = [str(tmp_path / os.fsdecode(name)) for name in NAMES]
    code, out, _ = run(capsys, "ingest", *files, "--json")
    assert (code, len(json.loads(out)["ingested"])) == (0, len(NAMES))
    assert len(json.loads(run(capsys, "ingest", *files, "--json")[1])["known"]) == len(NAMES)
    assert "object_in_box-0" in run(capsys, "demos", "list")[1]


def test_any_name_of_a_damaged_file_gets_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in NAMES:
        (tmp_path / os.fsdecode(name)).write_bytes(b"noise")
        for command in ("ingest", "recover", "replay"):
            code, _, err = run(capsys, command, str(tmp_path / os.fsdecode(name)))
            assert code == 1
            assert len(err.splitlines()) == 1, err


def test_what_is_no_file_is_said_and_the_rest_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    (tmp_path / "loop.mcap").symlink_to("loop.mcap")
    (tmp_path / "folder.mcap").mkdir()
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "s.mcap"))
        odd = {
            str(tmp_path / "pipe.mcap"): "it is a named pipe",
            str(tmp_path / "s.mcap"): "it is a socket",
            "/dev/zero": "it is a device",
            str(tmp_path / "loop.mcap"): "symbolic links",
            str(tmp_path / ("a" * 300)): "name too long",
            str(tmp_path / "typo.mcap"): "o such file",
        }
        good = object_in_box(1).write(tmp_path / "good.mcap")
        code, out, _ = run(capsys, "ingest", *odd, str(good), "--json")
        document = json.loads(out)
        assert (code, document["ingested"]) == (1, ["object_in_box-1"])
        reasons = {entry["file"]: entry["reason"] for entry in document["quarantined"]}
        assert set(reasons) == set(odd)
        for file, words in odd.items():
            assert words in reasons[file]
            for command in ("recover", "replay"):
                code, _, err = run(capsys, command, file)
                assert code == 1
                assert words in err


def test_a_name_that_is_no_file_is_told_as_that_and_not_as_quarantined(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    typo = tmp_path / "typo.mcap"
    code, out, err = run(capsys, "ingest", str(typo))
    assert (code, err) == (1, f"treewright: {typo}: there is no such file\n")
    assert out.splitlines()[0] == f"{typo}: there is no such file"


def test_the_list_names_what_is_in_quarantine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    object_in_box(1).saying(outcome="fine").write(tmp_path / "bad.mcap")
    (tmp_path / "noise.mcap").write_bytes(b"noise")
    run(capsys, "ingest", str(tmp_path / "bad.mcap"), str(tmp_path / "noise.mcap"))
    listed = json.loads(run(capsys, "demos", "list", "--json")[1])["quarantined"]
    assert {each["demonstration_id"] for each in listed} == {"object_in_box-1", None}
    assert "quarantined object_in_box-1 (" in run(capsys, "demos", "list")[1]
