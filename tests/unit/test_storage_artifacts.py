"""The artifact store: versions, aliases, manifests, and what happens to damaged or racing ones."""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import sqlalchemy as sa

from learner.errors import NameRefusedError
from learner.model import Drop, Pick, Tree
from learner.model.condition import InGripper
from learner.model.tree import Definition, Node, fallback, leaf, sequence, subtree
from storage.artifacts import ArtifactStore, Change, Published
from storage.btcpp import from_xml, to_xml
from storage.errors import (
    AliasRefusedError,
    DamagedError,
    DoubtfulError,
    ManifestRefusedError,
    NotStoredError,
    StorageUnavailableError,
    WrittenTreeError,
)

UNIT = (0.0, 0.0, 0.0, 1.0)
FACTS = {
    "base_frame": "base",
    "lineage": {"demonstrations": [{"id": "d1", "sha256": "0" * 64}]},
    "metrics": {"cost": 1},
}


def tree(x: float = 0.1) -> Tree:
    drop = Drop("A", "box", (x, 0.0, 0.2), UNIT, (x, 0.0, 0.0))
    fetch = fallback(leaf(InGripper("A")), leaf(Pick("A", "A", (0.0, 0.0, 0.0), UNIT)))
    recover = Definition("Recover_A", fetch)
    return Tree(
        Definition("Main", fallback(leaf(drop.achieves), sequence(fetch, leaf(drop)), subtree("Recover_A"))), (recover,)
    )


@pytest.fixture
def store(tmp_path: Path) -> ArtifactStore:
    return ArtifactStore(tmp_path / "store")


def test_an_empty_store_is_read_as_empty_and_not_created(store: ArtifactStore) -> None:
    assert store.tasks() == []
    assert store.changes() == []
    with pytest.raises(NotStoredError, match="no tree 'kitting'; stored: none"):
        store.get("kitting")
    assert not store.root.exists()


def test_a_published_tree_comes_back_with_its_manifest(store: ArtifactStore) -> None:
    published = store.publish("kitting", tree(), FACTS)
    artifact = store.get("kitting", 1)
    assert published == Published(1, tree().digest, True)
    assert artifact.tree == tree()
    assert artifact.xml == to_xml(tree())
    manifest = dict(artifact.manifest)
    assert manifest.pop("created").endswith("Z")
    assert manifest == {
        **FACTS,
        "contract": "1",
        "digest": tree().digest,
        "end_effector_frame": None,
        "frames": ["A", "box"],
        "leaves": ["Drop", "InGripper", "ObjectRoughlyAt", "Pick"],
        "nodes": 7,
        "nodes_recovery": 3,
        "nodes_written": 11,
        "objects": ["A"],
        "task": "kitting",
        "version": 1,
        "vocabulary": 1,
        "xml_sha256": hashlib.sha256(artifact.xml.encode()).hexdigest(),
    }
    assert artifact.manifest_json == json.dumps(artifact.manifest, sort_keys=True, separators=(",", ":"))


def test_versions_count_from_one_within_each_task(store: ArtifactStore) -> None:
    assert [store.publish("kitting", tree(x), {}).version for x in (0.1, 0.2, 0.3)] == [1, 2, 3]
    assert store.publish("towers", tree(0.1), {}).version == 1
    assert [row["version"] for row in store.versions("kitting")] == [3, 2, 1]


def test_an_equal_tree_makes_no_new_version_even_if_it_is_not_the_newest(store: ArtifactStore) -> None:
    store.publish("kitting", tree(0.1), {"metrics": 1})
    store.publish("kitting", tree(0.2), {})
    assert store.publish("kitting", tree(0.1), {"metrics": 2}) == Published(1, tree(0.1).digest, False)
    assert store.get("kitting", 1).manifest["metrics"] == 1
    assert len(store.versions("kitting")) == 2


def test_numbers_written_as_integers_are_the_same_tree(store: ArtifactStore) -> None:
    floats = Node("Pick", (("frame", "A"), ("object", "A"), ("orientation", UNIT), ("position", (0.0, 1.0, 2.0))))
    integers = Node("Pick", (("frame", "A"), ("object", "A"), ("orientation", (0, 0, 0, 1)), ("position", (0, 1, 2))))
    store.publish("t", Tree(Definition("Main", integers)), {})
    assert not store.publish("t", Tree(Definition("Main", floats)), {}).new
    artifact = store.verify("t")
    assert from_xml(artifact.xml).digest == artifact.digest


def test_a_reference_is_a_version_an_alias_or_else_production_before_latest(store: ArtifactStore) -> None:
    for x in (0.1, 0.2, 0.3):
        store.publish("kitting", tree(x), {})
    assert store.get("kitting").version == 3
    assert store.alias("kitting", "latest", 2)
    assert store.get("kitting").version == 2
    assert store.alias("kitting", "production", 1)
    assert store.get("kitting").version == 1
    assert [store.get("kitting", ref).version for ref in (3, "3", "latest", "production")] == [3, 3, 2, 1]
    assert store.get("kitting", 1).aliases == ("production",)
    assert store.aliases("kitting") == {"latest": 2, "production": 1}
    assert [(row["task"], row["version"], row["aliases"]) for row in store.tasks()] == [
        ("kitting", 3, {"latest": 2, "production": 1})
    ]


def test_an_alias_moves_and_moving_it_to_where_it_is_changes_nothing(store: ArtifactStore) -> None:
    store.publish("kitting", tree(0.1), {})
    store.publish("kitting", tree(0.2), {})
    assert store.alias("kitting", "production", 1)
    assert not store.alias("kitting", "production", 1)
    assert store.alias("kitting", "production", 2)
    assert store.get("kitting", "production").version == 2
    assert [(change.event, change.version, change.alias) for change in store.changes()] == [
        ("published", 1, None),
        ("published", 2, None),
        ("alias", 1, "production"),
        ("alias", 2, "production"),
    ]


def test_what_is_not_stored_is_named_with_what_is(store: ArtifactStore) -> None:
    store.publish("kitting", tree(), {})
    store.alias("kitting", "latest", 1)
    with pytest.raises(NotStoredError, match="no tree 'towers'; stored: kitting"):
        store.versions("towers")
    for ref in (7, "7", "stable", "-1", "1.0", ""):
        with pytest.raises(NotStoredError, match=r"no version of kitting .*; stored: 1, latest"):
            store.get("kitting", ref)
    with pytest.raises(NotStoredError):
        store.alias("kitting", "production", 2)


@pytest.mark.parametrize("name", ["../escape", "", "a b", "x" * 65, ".hidden", "a/b"])
def test_bad_names_are_refused_and_never_become_paths(store: ArtifactStore, name: str) -> None:
    with pytest.raises(NameRefusedError):
        store.publish(name, tree(), {})
    with pytest.raises(NameRefusedError):
        store.get(name)
    store.publish("kitting", tree(), {})
    with pytest.raises(NameRefusedError):
        store.alias("kitting", name, 1)


def test_an_alias_starts_with_a_letter(store: ArtifactStore) -> None:
    store.publish("kitting", tree(), {})
    with pytest.raises(NameRefusedError):
        store.alias("kitting", "7", 1)


def test_a_tree_with_a_counterexample_that_nobody_judged_gets_no_alias_but_doubtful(store: ArtifactStore) -> None:
    store.publish("kitting", tree(0.1), {"certificate": {"counterexample": ["A is covered"]}})
    store.publish("kitting", tree(0.2), {"certificate": {"counterexample": None}})
    assert store.alias("kitting", "doubtful", 1)
    assert store.alias("kitting", "production", 2)
    for name in ("production", "latest"):
        with pytest.raises(AliasRefusedError, match="kitting@1 has a counterexample"):
            store.alias("kitting", name, 1)
    assert store.aliases("kitting") == {"doubtful": 1, "production": 2}


def test_a_judged_version_is_latest_or_doubtful(store: ArtifactStore) -> None:
    for x in (0.1, 0.2):
        store.publish("kitting", tree(x), {})
    store.judge("kitting", 1, (), chosen_ns=10)
    store.judge("kitting", 2, ("B has no place",), chosen_ns=20)
    assert store.aliases("kitting") == {"doubtful": 2, "latest": 1}
    assert store.get("kitting", 2).standing.doubtful == ("B has no place",)
    assert [row["doubtful"] for row in store.versions("kitting")] == [["B has no place"], []]
    store.judge("kitting", 2, (), chosen_ns=30)
    assert store.aliases("kitting") == {"latest": 2}


def test_what_becomes_doubtful_gives_latest_back(store: ArtifactStore) -> None:
    for number, x in enumerate((0.1, 0.2, 0.3), start=1):
        store.publish("kitting", tree(x), {})
        store.judge("kitting", number, (), chosen_ns=number)
    store.judge("kitting", 2, ("it is not proven",), chosen_ns=4)
    store.judge("kitting", 3, ("it is not proven",), chosen_ns=5)
    assert store.aliases("kitting") == {"doubtful": 3, "latest": 1}
    store.judge("kitting", 1, ("it is not proven",), chosen_ns=6)
    assert store.aliases("kitting") == {"doubtful": 1}
    with pytest.raises(DoubtfulError, match="approve kitting@1"):
        store.get("kitting")
    assert [change.event for change in store.changes()][-1] == "unalias"


def test_a_learner_that_was_slow_sets_nothing_back(store: ArtifactStore) -> None:
    for x in (0.1, 0.2):
        store.publish("kitting", tree(x), {})
    store.judge("kitting", 2, (), chosen_ns=20)
    store.judge("kitting", 1, (), chosen_ns=10)
    assert store.aliases("kitting") == {"latest": 2}
    store.judge("kitting", 1, (), chosen_ns=30)
    assert store.aliases("kitting") == {"latest": 1}


def test_a_person_approves_what_is_doubted_and_the_store_keeps_who_and_when(store: ArtifactStore) -> None:
    store.publish("kitting", tree(0.1), {})
    store.judge("kitting", 1, ("B has no place",), chosen_ns=10)
    for name in ("latest", "production"):
        with pytest.raises(AliasRefusedError, match=r"kitting@1 is doubtful .* B has no place"):
            store.alias("kitting", name, 1)
    assert store.approve("kitting", "doubtful", "ann")[0] == 1
    assert store.aliases("kitting") == {"latest": 1}
    (approval,) = store.get("kitting").standing.approved
    assert approval["by"] == "ann"
    assert abs(approval["stamp_ns"] - time.time_ns()) < 60e9
    assert store.alias("kitting", "production", 1)
    with pytest.raises(AliasRefusedError, match="nothing is doubted"):
        store.approve("kitting", 1, "ann")


def test_an_approval_covers_what_was_doubted_then_and_no_new_doubt(store: ArtifactStore) -> None:
    store.publish("kitting", tree(0.1), {})
    store.judge("kitting", 1, ("B has no place",), chosen_ns=10)
    store.approve("kitting", 1, "ann")
    store.judge("kitting", 1, ("B has no place",), chosen_ns=20)
    assert store.aliases("kitting") == {"latest": 1}
    store.judge("kitting", 1, ("B has no place", "C is turned alike"), chosen_ns=30)
    assert store.aliases("kitting") == {"doubtful": 1}
    assert store.get("kitting", 1).standing.doubtful == ("C is turned alike",)


def test_a_database_of_an_earlier_version_gets_the_new_tables_when_it_is_read(store: ArtifactStore) -> None:
    store.publish("kitting", tree(0.1), {})
    store.alias("kitting", "latest", 1)
    store.close()
    with sqlite3.connect(store.root / "store.sqlite") as database:
        database.execute("DROP TABLE standings")
        database.execute("DROP TABLE approvals")
    with ArtifactStore(store.root) as again:
        assert again.get("kitting").standing.doubtful == ()


def test_facts_that_the_store_states_itself_or_that_are_not_json_are_refused(store: ArtifactStore) -> None:
    with pytest.raises(ManifestRefusedError, match="version"):
        store.publish("kitting", tree(), {"version": 7})
    for fact in ({1, 2}, float("nan")):
        with pytest.raises(ManifestRefusedError, match="not JSON"):
            store.publish("kitting", tree(), {"metrics": fact})
    assert store.tasks() == []


def test_a_tree_that_cannot_be_written_is_not_published(store: ArtifactStore) -> None:
    badly_named = Tree(Definition("Main", leaf(InGripper("no name"))))
    with pytest.raises(WrittenTreeError):
        store.publish("kitting", badly_named, {})
    assert store.tasks() == []


def test_racing_publishers_get_one_version_each_and_equal_trees_share_one(store: ArtifactStore) -> None:
    positions = [0.01 * number for number in range(6)]

    def publish(x: float) -> tuple[float, int, bool]:
        with ArtifactStore(store.root) as mine:
            published = mine.publish("kitting", tree(x), {})
            mine.alias("kitting", "latest", published.version)
            return x, published.version, published.new

    with ThreadPoolExecutor(6) as pool:
        results = list(pool.map(publish, positions * 2))
    assert sum(new for _, _, new in results) == 6
    assert len({(x, version) for x, version, _ in results}) == 6
    assert [row["version"] for row in store.versions("kitting")] == [6, 5, 4, 3, 2, 1]
    for row in store.versions("kitting"):
        store.verify("kitting", row["version"])
    serials = [change.serial for change in store.changes()]
    assert serials == sorted(serials)


def test_another_process_sees_the_same_store_and_its_changes_are_noticed(store: ArtifactStore) -> None:
    store.publish("kitting", tree(), {})
    before = store.last_change()
    script = (
        "import sys; from pathlib import Path; from storage.artifacts import ArtifactStore; "
        "ArtifactStore(Path(sys.argv[1])).alias('kitting', 'production', 1)"
    )
    subprocess.run([sys.executable, "-c", script, str(store.root)], check=True)
    (change,) = store.changes(before)
    assert isinstance(change, Change)
    assert (change.event, change.alias, change.digest) == ("alias", "production", tree().digest)


def stored_files(store: ArtifactStore) -> list[Path]:
    return [path for path in (store.root / "objects").rglob("*") if path.is_file()]


def test_files_are_named_by_their_digest(store: ArtifactStore) -> None:
    store.publish("kitting", tree(), {})
    files = stored_files(store)
    assert len(files) == 3
    assert all(hashlib.sha256(path.read_bytes()).hexdigest() == path.name for path in files)


@pytest.mark.parametrize("index", range(3))
def test_a_changed_or_lost_byte_is_found_at_reading(store: ArtifactStore, index: int) -> None:
    store.publish("kitting", tree(), {})
    assert store.verify("kitting").tree == tree()
    victim = sorted(stored_files(store))[index]
    content = victim.read_bytes()
    victim.chmod(0o644)
    victim.write_bytes(content[:-2] + b"!\n")
    with pytest.raises(DamagedError, match=victim.name):
        store.get("kitting")
    victim.unlink()
    with pytest.raises(DamagedError, match="is gone"):
        store.get("kitting")


def test_a_damaged_manifest_blocks_no_list(store: ArtifactStore) -> None:
    for x in (0.1, 0.2):
        store.publish("kitting", tree(x), {})
    store.publish("towers", tree(0.1), {})
    whole = [row for row in store.versions("kitting") if row["version"] == 2]
    (store.root / "objects" / manifest_sha256(store, 1)[:2] / manifest_sha256(store, 1)).unlink()
    assert [row["task"] for row in store.tasks()] == ["kitting", "towers"]
    second, first = store.versions("kitting")
    assert [second] == whole
    assert (first["digest"], first["created"]) == (tree(0.1).digest, None)
    assert "the manifest of kitting@1 is gone" in first["damaged"]


def manifest_sha256(store: ArtifactStore, version: int) -> str:
    with sqlite3.connect(store.root / "store.sqlite") as database:
        query = "SELECT manifest_sha256 FROM versions WHERE task = 'kitting' AND version = ?"
        return str(database.execute(query, (version,)).fetchone()[0])


def test_what_was_read_and_has_not_changed_is_not_read_again_and_what_has_changed_is(store: ArtifactStore) -> None:
    store.publish("kitting", tree(), {})
    first, second = store.get("kitting"), store.get("kitting")
    assert second.xml is first.xml
    assert second.served_json is first.served_json
    path = store.root / "objects" / tree().digest[:2] / tree().digest
    before = path.stat()
    path.chmod(0o644)
    path.write_bytes(path.read_bytes().replace(b"0", b"1"))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    with pytest.raises(DamagedError, match="does not have its digest"):
        store.get("kitting")


def test_publishing_again_repairs_a_damaged_file(store: ArtifactStore) -> None:
    store.publish("kitting", tree(), {})
    victim = store.root / "objects" / tree().digest[:2] / tree().digest
    victim.unlink()
    victim.write_text("damaged")
    store.publish("towers", tree(), {})
    assert store.verify("kitting").tree == tree()


def test_a_database_that_confuses_files_is_found_by_verify(store: ArtifactStore) -> None:
    store.publish("kitting", tree(0.1), {})
    store.publish("kitting", tree(0.2), {})
    other = store.get("kitting", 2)
    engine = sa.create_engine(f"sqlite:///{store.root / 'store.sqlite'}")
    with engine.begin() as connection:
        connection.execute(
            sa.text("UPDATE versions SET xml_sha256 = :sha WHERE version = 1"), {"sha": other.manifest["xml_sha256"]}
        )
    with pytest.raises(DamagedError, match="another tree"):
        store.verify("kitting", 1)
    with engine.begin() as connection:
        connection.execute(sa.text("UPDATE versions SET digest = '../../etc/passwd' WHERE version = 1"))
    with pytest.raises(DamagedError, match="digest"):
        store.verify("kitting", 1)


def test_a_store_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageUnavailableError, match="file/store cannot be used"):
        ArtifactStore(tmp_path / "file" / "store").publish("kitting", tree(), {})
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "store.sqlite").write_text("this is no database, and long enough to be looked at" * 20)
    with pytest.raises(StorageUnavailableError, match="cannot be used"):
        ArtifactStore(tmp_path / "store").tasks()
    with pytest.raises(StorageUnavailableError, match="URL"):
        ArtifactStore(tmp_path / "store", "nosuchdatabase://x")


def test_a_database_whose_tables_another_process_is_about_to_make_reads_as_empty(tmp_path: Path) -> None:
    (tmp_path / "store.sqlite").touch()
    with ArtifactStore(tmp_path) as store:
        assert (store.tasks(), store.changes(), store.last_change()) == ([], [], 0)
