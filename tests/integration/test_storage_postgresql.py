"""The artifact store with its metadata in PostgreSQL: a URL away. Runs where a server can be started."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from learner.model import Drop, Tree
from learner.model.tree import Definition, leaf
from storage.artifacts import ArtifactStore
from storage.errors import StorageUnavailableError

pytest.importorskip("psycopg", reason="no driver for PostgreSQL")

UNIT = (0.0, 0.0, 0.0, 1.0)


def tree(x: float) -> Tree:
    return Tree(Definition("Main", leaf(Drop("A", "box", (x, 0.0, 0.2), UNIT, (x, 0.0, 0.0)))))


def binary(name: str) -> str:
    places = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    found = str(places[-1]) if places else shutil.which(name)
    if not found:
        pytest.skip("no PostgreSQL is installed")
    return found


def server_user() -> str | None:
    """The server refuses to run as root."""
    if os.geteuid() != 0:
        return None
    if "postgres" not in {entry.pw_name for entry in pwd.getpwall()}:
        pytest.skip("no user to run PostgreSQL as")
    return "postgres"


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    initdb, control, user = binary("initdb"), binary("pg_ctl"), server_user()
    with tempfile.TemporaryDirectory() as folder:
        if user:
            shutil.chown(folder, user)
        data = f"{folder}/data"
        options = f"-k {folder} -c listen_addresses='' -c fsync=off"

        def call(*words: str) -> None:
            subprocess.run(words, check=True, user=user, cwd=folder, stdout=subprocess.DEVNULL, timeout=120)

        call(initdb, "--auth=trust", "--username=postgres", "--no-sync", "-D", data)
        call(control, "-D", data, "-o", options, "-l", f"{folder}/log", "-w", "start")
        try:
            yield f"postgresql+psycopg://postgres@/postgres?host={folder}"
        finally:
            call(control, "-D", data, "-m", "immediate", "-w", "stop")


def test_a_store_in_postgresql_publishes_aliases_and_verifies(tmp_path: Path, url: str) -> None:
    with ArtifactStore(tmp_path, url) as store:
        assert store.tasks() == []
        assert store.publish("single", tree(0.1), {}).new
        assert not store.publish("single", tree(0.1), {}).new
        assert store.alias("single", "production", 1)
        assert not store.alias("single", "production", 1)
        assert store.verify("single").tree == tree(0.1)
    with ArtifactStore(tmp_path, url) as another:
        assert another.aliases("single") == {"production": 1}


def test_racing_publishers_on_postgresql_get_one_version_each(tmp_path: Path, url: str) -> None:
    positions = [0.01 * number for number in range(6)]

    def publish(x: float) -> bool:
        with ArtifactStore(tmp_path, url) as mine:
            published = mine.publish("raced", tree(x), {})
            mine.alias("raced", "latest", published.version)
            return published.new

    with ThreadPoolExecutor(6) as pool:
        assert sum(pool.map(publish, positions * 2)) == len(positions)
    with ArtifactStore(tmp_path, url) as store:
        assert [row["version"] for row in store.versions("raced")] == [6, 5, 4, 3, 2, 1]
        serials = [change.serial for change in store.changes()]
    assert serials == sorted(serials)


def test_a_database_that_does_not_answer_is_named_without_its_password(tmp_path: Path) -> None:
    with pytest.raises(StorageUnavailableError, match="cannot be used") as caught:
        ArtifactStore(tmp_path, "postgresql+psycopg://u:secret@127.0.0.1:1/x").tasks()
    assert "secret" not in str(caught.value)
