"""`treewright store`, `demos` and `relabel`, as they are called."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support_demonstrations import demonstration

from learner.model import Drop, Tree
from learner.model.tree import Definition, leaf
from pipelines.cli import main
from storage.artifacts import ArtifactStore
from storage.btcpp import from_xml
from storage.lake import Lake

UNIT = (0.0, 0.0, 0.0, 1.0)


def tree(x: float) -> Tree:
    return Tree(Definition("Main", leaf(Drop("A", "box", (x, 0.0, 0.2), UNIT, (x, 0.0, 0.0)))))


class Home:
    """A data root with two versions of a tree and two demonstrations, and the commands run on it."""

    def __init__(self, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.root, self._capsys = root, capsys
        self.lake = Lake(root / "lake")
        self.lake.add_all([demonstration("d1"), demonstration("d2")])
        self.lake.quarantine("torn.mcap", None, "it is torn")
        with ArtifactStore(root / "store") as store:
            for x in (0.1, 0.2):
                store.publish("kitting", tree(x), {"base_frame": "base"})
            store.alias("kitting", "latest", 2)

    def run(self, *words: str) -> str:
        assert main(words) == 0
        captured = self._capsys.readouterr()
        assert captured.err == ""
        return captured.out

    def json(self, *words: str) -> Any:
        return json.loads(self.run(*words, "--json"))

    def fail(self, *words: str) -> str:
        assert main(words) == 1
        captured = self._capsys.readouterr()
        assert captured.out == ""
        assert captured.err.count("\n") == 1
        assert "defect" not in captured.err
        return captured.err


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Home:
    monkeypatch.setenv("TREEWRIGHT_HOME", str(tmp_path / "home"))
    monkeypatch.delenv("TREEWRIGHT_STORE_URL", raising=False)
    return Home(tmp_path / "home", capsys)


def test_store_list_tells_tasks_versions_and_aliases(home: Home) -> None:
    (row,) = home.json("store", "list")
    versions = row.pop("versions")
    assert row == {"task": "kitting", "version": 2, "digest": tree(0.2).digest, "aliases": {"latest": 2}}
    assert [(each["version"], each["aliases"], each["doubtful"]) for each in versions] == [
        (2, ["latest"], []),
        (1, [], []),
    ]
    lines = home.run("store", "list").splitlines()
    assert [line.split()[0] for line in lines] == ["kitting@2", "kitting@1"]
    assert home.run("store", "--json", "list") == home.run("store", "list", "--json")


def test_store_show_is_a_page_for_people(home: Home) -> None:
    page = home.run("store", "show", "kitting")
    assert page.startswith("kitting@2 (latest), ")
    assert f"digest {tree(0.2).digest}" in page
    assert "{" not in page


def test_store_show_tells_the_manifest_of_production_else_latest(home: Home) -> None:
    shown = home.json("store", "show", "kitting")
    assert (shown["version"], shown["digest"], shown["base_frame"], shown["aliases"]) == (
        2,
        tree(0.2).digest,
        "base",
        ["latest"],
    )
    home.run("store", "alias", "kitting", "production", "1")
    assert home.json("store", "show", "kitting")["version"] == 1
    assert home.json("store", "show", "kitting@2")["version"] == 2
    assert home.json("store", "show", "kitting@latest")["version"] == 2


def test_store_diff_tells_in_words_what_changed(home: Home) -> None:
    page = home.run("store", "diff", "kitting@1", "kitting@2")
    assert page.startswith("kitting@1 (1 node, and 0 that only recover) and kitting@2 (")
    assert "Poses:\n  - the hand lets A go 100.0 mm off (+100.0, +0.0, +0.0) relative to box" in page
    told = home.json("store", "diff", "kitting@1", "kitting@latest")
    assert told["from"] == {"task": "kitting", "version": 1, "digest": tree(0.1).digest}
    assert (told["to"]["version"], told["equal"]) == (2, False)
    assert [(change["what"], change["object"]) for change in told["changes"]] == [("pose", "A")]


def test_store_diff_tells_which_demonstrations_and_doubts_came(home: Home) -> None:
    with ArtifactStore(home.root / "store") as store:
        lineage = {"method": "treewright", "demonstrations": [{"demonstration_id": "d1"}]}
        store.publish("kitting", tree(0.3), {"lineage": lineage})
        store.judge("kitting", 3, ["A was turned the same way each time"], 1)
    page = home.run("store", "diff", "kitting@2", "kitting@3")
    assert "1 demonstration now, 0 before: 1 new, 0 left out" in page
    assert "doubtful now, because A was turned the same way each time" in page
    assert "not doubted any more" in home.run("store", "diff", "kitting@3", "kitting@2")


def test_store_diff_of_a_version_with_itself_is_empty(home: Home) -> None:
    assert "The trees are equal." in home.run("store", "diff", "kitting@2", "kitting@latest")
    told = home.json("store", "diff", "kitting@2", "kitting@2")
    assert (told["equal"], told["changes"]) == (True, [])
    assert "no version of kitting '9'" in home.fail("store", "diff", "kitting@1", "kitting@9")


def test_store_export_writes_every_format(home: Home, tmp_path: Path) -> None:
    file = tmp_path / "out.xml"
    report = home.json("store", "export", "kitting@1", "--format", "btcpp", "-o", str(file))
    digest = tree(0.1).digest
    assert report == {"task": "kitting", "version": 1, "digest": digest, "format": "btcpp", "file": str(file)}
    assert from_xml(file.read_text()) == tree(0.1)
    home.run("store", "export", "kitting@1", "--format", "json", "-o", str(file))
    assert Tree.from_json(file.read_text()) == tree(0.1)
    home.run("store", "export", "kitting", "--format", "svg", "-o", str(file))
    assert file.read_text().startswith("<svg")
    assert list(tmp_path.glob(".*.part")) == []
    assert from_xml(home.run("store", "export", "kitting@1")) == tree(0.1)


def test_an_export_that_cannot_be_written_leaves_what_was_there(home: Home, tmp_path: Path) -> None:
    assert "missing" in home.fail("store", "export", "kitting", "-o", str(tmp_path / "missing" / "out.xml"))
    (tmp_path / "folder").mkdir()
    assert "folder" in home.fail("store", "export", "kitting", "-o", str(tmp_path / "folder"))
    assert list(tmp_path.glob(".*.part")) == []


def test_json_and_a_tree_on_standard_output_are_wrong_usage(home: Home) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["store", "export", "kitting", "--json"])
    assert caught.value.code == 2


def test_store_alias_moves_and_verify_checks(home: Home) -> None:
    assert home.json("store", "alias", "kitting", "production", "2") == {
        "task": "kitting",
        "alias": "production",
        "version": 2,
        "changed": True,
    }
    assert not home.json("store", "alias", "kitting", "production", "2")["changed"]
    verified = home.json("store", "verify", "kitting@production")
    assert verified == {"task": "kitting", "version": 2, "digest": tree(0.2).digest, "verified": True}
    path = home.root / "store" / "objects" / tree(0.2).digest[:2] / tree(0.2).digest
    path.chmod(0o644)
    path.write_text("damaged")
    assert "is damaged" in home.fail("store", "verify", "kitting")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("show", "towers"), "no tree 'towers'; stored: kitting"),
        (("show", "kitting@9"), "no version of kitting '9'; stored: 1, 2, latest"),
        (("show", "kitting@stable"), "'stable'"),
        (("show", "../kitting"), "is refused"),
        (("show", "kitting@"), "is refused"),
        (("alias", "kitting", "7up", "1"), "an alias starts with a letter"),
        (("alias", "kitting", "production", "9"), "no version of kitting '9'"),
        (("verify", "kitting@0"), "0"),
    ],
)
def test_what_the_store_cannot_do_is_one_sentence(home: Home, words: tuple[str, ...], sentence: str) -> None:
    assert sentence in home.fail("store", *words)


@pytest.mark.parametrize(
    "words", [(), ("alias", "kitting", "production", "one"), ("export", "kitting", "--format", "png")]
)
def test_wrong_usage_exits_2(home: Home, words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["store", *words])
    assert caught.value.code == 2


def test_an_empty_home_is_told_as_empty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TREEWRIGHT_HOME", str(tmp_path / "new"))
    assert main(["store", "list", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == []
    assert main(["demos", "list", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"demonstrations": [], "quarantined": []}
    assert not (tmp_path / "new").exists()


def test_the_database_may_lie_elsewhere(home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TREEWRIGHT_STORE_URL", f"sqlite:///{tmp_path / 'other.sqlite'}")
    assert home.json("store", "list") == []
    assert (tmp_path / "other.sqlite").exists()


def test_demos_list_and_show_tell_what_was_demonstrated(home: Home) -> None:
    listed = home.json("demos", "list")
    assert [(row["demonstration_id"], row["actions"], row["excluded"]) for row in listed["demonstrations"]] == [
        ("d1", 2, False),
        ("d2", 2, False),
    ]
    assert listed["quarantined"] == [
        {"file": "torn.mcap", "demonstration_id": None, "sha256": None, "reason": "it is torn"}
    ]
    assert home.json("demos", "list", "--task", "towers")["demonstrations"] == []
    shown = home.json("demos", "show", "d1")
    assert [(action["step"], action["type"]) for action in shown["actions"]] == [(1, "pick"), (2, "drop")]
    assert shown["actions"][1]["rest"]["position"] == [0.4, 0.1, 0.02]
    assert shown["base_frame"] == "base"
    said = home.run("demos", "show", "d1")
    assert "2  drop A at (0.410, 0.090, 0.200); A was not seen at rest." in said


def test_demos_exclude_and_restore(home: Home) -> None:
    assert home.json("demos", "exclude", "d1") == {"demonstration_id": "d1", "excluded": True, "changed": True}
    assert not home.json("demos", "exclude", "d1")["changed"]
    assert [each.demonstration_id for each in home.lake.demonstrations()] == ["d2"]
    assert "excluded" in home.run("demos", "list")
    assert home.json("demos", "restore", "d1") == {"demonstration_id": "d1", "excluded": False, "changed": True}
    assert "no demonstration 'd9'; stored: d1, d2" in home.fail("demos", "exclude", "d9")


def test_relabel_corrects_and_remembers(home: Home) -> None:
    assert home.json("relabel", "d1", "2", "place") == {
        "demonstration_id": "d1",
        "step": 2,
        "type": "place",
        "demonstrated_type": "drop",
        "changed": True,
    }
    shown = home.json("demos", "show", "d1")
    assert (shown["relabelled"], shown["actions"][1]["demonstrated_type"]) == ([2], "drop")
    assert "only place and drop can be exchanged" in home.fail("relabel", "d1", "1", "drop")
    assert "no step of d1 '9'" in home.fail("relabel", "d1", "9", "drop")
