"""The artifact store as it is served: over Zenoh on loopback, and over HTTP."""

from __future__ import annotations

import json
import queue
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import zenoh

from learner.errors import NameRefusedError
from learner.model import Drop, Tree
from learner.model.tree import Definition, leaf
from storage.artifacts import ArtifactStore
from storage.client import Fetched, check_xml, fetch
from storage.errors import DamagedError, NotStoredError, StorageUnavailableError
from storage.http import StoreOnHttp
from storage.serving import StoreOnZenoh

UNIT = (0.0, 0.0, 0.0, 1.0)


def tree(x: float) -> Tree:
    return Tree(Definition("Main", leaf(Drop("A", "box", (x, 0.0, 0.2), UNIT, (x, 0.0, 0.0)))))


@pytest.fixture
def store(tmp_path: Path) -> Iterator[ArtifactStore]:
    with ArtifactStore(tmp_path / "store") as store:
        for x in (0.1, 0.2, 0.3):
            store.publish("kitting", tree(x), {"base_frame": "base"})
        store.alias("kitting", "latest", 3)
        yield store


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


@pytest.fixture(scope="module")
def sessions() -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    """Two sessions that know only each other."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_session("listen", endpoint) as server, open_session("connect", endpoint) as asker:
        yield server, asker


def open_session(how: str, endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5(f"{how}/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


def replies(asker: zenoh.Session, selector: str) -> list[zenoh.Reply]:
    """What is answered, once the asker has learned who answers."""
    deadline_s = time.monotonic() + 20
    while time.monotonic() < deadline_s:
        if found := list(asker.get(f"treewright/artifacts/{selector}", timeout=5.0)):
            return found
        time.sleep(0.05)
    raise AssertionError(f"nobody answers {selector}")


def test_a_controller_fetches_by_version_alias_or_neither(
    store: ArtifactStore, sessions: tuple[zenoh.Session, zenoh.Session]
) -> None:
    server, asker = sessions
    with StoreOnZenoh(server, store):
        assert fetch(asker, "kitting", version=1) == Fetched(
            store.get("kitting", 1).xml, json.loads(store.get("kitting", 1).served_json)
        )
        assert fetch(asker, "kitting", alias="latest").manifest["version"] == 3
        assert fetch(asker, "kitting").manifest["version"] == 3
        store.alias("kitting", "production", 2)
        assert fetch(asker, "kitting").manifest["version"] == 2


def test_a_reply_is_xml_with_the_manifest_attached(
    store: ArtifactStore, sessions: tuple[zenoh.Session, zenoh.Session]
) -> None:
    server, asker = sessions
    with StoreOnZenoh(server, store):
        (reply,) = replies(asker, "kitting?version=2")
    sample = reply.ok
    assert sample is not None
    assert sample.attachment is not None
    assert str(sample.encoding) == "application/xml"
    assert str(sample.key_expr) == "treewright/artifacts/kitting"
    assert sample.payload.to_string() == store.get("kitting", 2).xml
    assert sample.attachment.to_string() == store.get("kitting", 2).served_json


def test_a_key_with_wildcards_answers_for_every_task_that_has_it(
    store: ArtifactStore, sessions: tuple[zenoh.Session, zenoh.Session]
) -> None:
    server, asker = sessions
    store.publish("towers", tree(0.1), {})
    with StoreOnZenoh(server, store):
        for selector, found in (
            ("*?version=1", {"kitting", "towers"}),
            ("*?version=3", {"kitting"}),
            ("to$*?version=1", {"towers"}),
        ):
            answered = {str(reply.ok.key_expr) for reply in replies(asker, selector) if reply.ok}
            assert answered == {f"treewright/artifacts/{task}" for task in found}


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ("towers", "no tree 'towers'; stored: kitting"),
        ("kitting?version=9", "no version of kitting '9'; stored: 1, 2, 3, latest"),
        ("kitting?alias=production", "no version of kitting 'production'"),
        ("kitting?version=one", "a version is a number, not 'one'"),
        ("kitting?alias=7", "an alias starts with a letter"),
        ("kitting?versoin=5", "no parameter 'versoin'; there are version and alias"),
        ("kitting?alias=versions", "this name is reserved"),
        ("kitting?alias=latest;version=1", "not for both"),
        (".hidden", "name '.hidden' is refused"),
    ],
)
def test_what_cannot_be_answered_is_an_error_reply_that_says_why(
    store: ArtifactStore, sessions: tuple[zenoh.Session, zenoh.Session], asked: str, sentence: str
) -> None:
    server, asker = sessions
    with StoreOnZenoh(server, store):
        (reply,) = replies(asker, asked)
    assert reply.err is not None
    document = json.loads(reply.err.payload.to_bytes())
    assert list(document) == ["error"]
    assert sentence in document["error"]


def test_a_damaged_store_answers_with_an_error_and_never_with_the_tree(
    store: ArtifactStore, sessions: tuple[zenoh.Session, zenoh.Session]
) -> None:
    server, asker = sessions
    path = store.root / "objects" / tree(0.3).digest[:2] / tree(0.3).digest
    path.unlink()
    with StoreOnZenoh(server, store), pytest.raises(NotStoredError, match="is gone"):
        fetch(asker, "kitting")


def test_a_store_that_does_not_answer_is_told_apart_from_one_that_has_no_such_tree(
    store: ArtifactStore, sessions: tuple[zenoh.Session, zenoh.Session]
) -> None:
    server, asker = sessions
    with pytest.raises(StorageUnavailableError, match="no artifact store answers"):
        fetch(asker, "kitting", timeout_s=0.5)
    with StoreOnZenoh(server, store), pytest.raises(NotStoredError, match="no tree 'towers'"):
        fetch(asker, "towers")
    with pytest.raises(NameRefusedError):
        fetch(asker, "**")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda xml, manifest: (xml.replace("0.3;", "0.4;"), manifest), "XML .* does not have the digest"),
        (lambda xml, manifest: (xml, manifest | {"digest": "0" * 64}), "tree .* does not have the digest"),
        (lambda xml, manifest: (xml, manifest | {"version": 7}), "asked for version 3"),
        (lambda xml, manifest: (xml, manifest | {"task": "towers"}), "asked for task kitting"),
        (lambda xml, manifest: (xml, [manifest]), "without a manifest"),
        (lambda xml, manifest: (xml, None), "without a manifest"),
    ],
)
def test_an_answer_that_is_not_what_was_published_is_refused(store, sessions, change, named) -> None:  # type: ignore[no-untyped-def]
    server, asker = sessions
    artifact = store.get("kitting", 3)
    xml, manifest = change(artifact.xml, dict(artifact.manifest))

    def lie(query: zenoh.Query) -> None:
        attachment = None if manifest is None else json.dumps(manifest)
        query.reply("treewright/artifacts/kitting", xml, attachment=attachment)

    queryable = server.declare_queryable("treewright/artifacts/*", lie)
    with pytest.raises(DamagedError, match=named):
        fetch(asker, "kitting", version=3)
    queryable.undeclare()


def test_a_refused_tree_is_damaged_even_if_its_digest_fits(store: ArtifactStore) -> None:
    artifact = store.get("kitting", 3)
    check_xml(artifact.xml, dict(artifact.manifest))
    with pytest.raises(DamagedError, match="digest"):
        check_xml(artifact.xml + " ", dict(artifact.manifest))


def test_changes_are_announced_whichever_process_made_them(
    store: ArtifactStore, sessions: tuple[zenoh.Session, zenoh.Session]
) -> None:
    server, asker = sessions
    events: queue.Queue[tuple[str, dict[str, object]]] = queue.Queue()
    subscriber = asker.declare_subscriber(
        "treewright/artifacts/*/events",
        lambda sample: events.put((str(sample.key_expr), json.loads(sample.payload.to_bytes()))),
    )
    script = (
        "import sys; from pathlib import Path; from storage.artifacts import ArtifactStore; "
        "ArtifactStore(Path(sys.argv[1])).alias('kitting', 'production', 2)"
    )
    with StoreOnZenoh(server, store, poll_s=0.05):
        subprocess.run([sys.executable, "-c", script, str(store.root)], check=True)
        store.publish("kitting", tree(0.4), {})
        first, second = events.get(timeout=20), events.get(timeout=20)
    subscriber.undeclare()
    assert first[0] == second[0] == "treewright/artifacts/kitting/events"
    assert first[1].pop("stamp_ns")
    assert first[1] == {
        "event": "alias",
        "task": "kitting",
        "version": 2,
        "alias": "production",
        "digest": tree(0.2).digest,
    }
    assert (second[1]["event"], second[1]["version"], second[1]["alias"]) == ("published", 4, None)


def test_a_damaged_tree_keeps_no_other_task_from_answering(
    store: ArtifactStore, sessions: tuple[zenoh.Session, zenoh.Session]
) -> None:
    server, asker = sessions
    store.publish("a-first", tree(0.7), {})
    store.publish("towers", tree(0.8), {})
    (store.root / "objects" / tree(0.7).digest[:2] / tree(0.7).digest).unlink()
    with StoreOnZenoh(server, store):
        found = replies(asker, "*")
    assert sorted(str(reply.ok.key_expr) for reply in found if reply.ok) == [
        "treewright/artifacts/kitting",
        "treewright/artifacts/towers",
    ]
    (refused,) = [reply.err.payload.to_string() for reply in found if reply.err]
    assert "the tree of a-first@1 is gone" in refused


@pytest.fixture
def http(store: ArtifactStore) -> Iterator[httpx.Client]:
    with StoreOnHttp(store, "127.0.0.1", 0) as served, httpx.Client(base_url=served.url, timeout=30) as client:
        yield client


def test_http_lists_tasks_and_versions(http: httpx.Client) -> None:
    assert http.get("/v1/tasks").json() == [
        {"task": "kitting", "version": 3, "digest": tree(0.3).digest, "aliases": {"latest": 3}}
    ]
    versions = http.get("/v1/tasks/kitting/versions").json()
    assert [(row["version"], row["aliases"]) for row in versions] == [(3, ["latest"]), (2, []), (1, [])]
    assert versions[0]["digest"] == tree(0.3).digest


def test_http_answers_manifests_and_trees_by_version_and_alias(http: httpx.Client, store: ArtifactStore) -> None:
    artifact = store.get("kitting", 3)
    for ref in ("3", "latest"):
        assert http.get(f"/v1/tasks/kitting/{ref}").json() == json.loads(artifact.served_json)
        for name, content, media_type in (
            ("tree.xml", artifact.xml, "application/xml"),
            ("tree.json", tree(0.3).to_json(), "application/json"),
        ):
            answer = http.get(f"/v1/tasks/kitting/{ref}/{name}")
            assert answer.text == content
            assert answer.headers["content-type"].startswith(media_type)
            assert answer.headers["etag"] == f'"{artifact.digest}"'
    picture = http.get("/v1/tasks/kitting/3/tree.svg")
    assert picture.headers["content-type"].startswith("image/svg+xml")
    assert picture.text.startswith("<svg")


@pytest.mark.parametrize("name", ["tree.xml", "tree.json", "tree.svg"])
def test_http_answers_304_to_who_has_the_tree(http: httpx.Client, name: str) -> None:
    path, digest = f"/v1/tasks/kitting/3/{name}", tree(0.3).digest
    for tag in (f'"{digest}"', f'W/"{digest}"', f'"other", "{digest}"', "*"):
        answer = http.get(path, headers={"If-None-Match": tag})
        assert (answer.status_code, answer.content, answer.headers["etag"]) == (304, b"", f'"{digest}"')
    for tag in ('"other"', digest):
        assert http.get(path, headers={"If-None-Match": tag}).status_code == 200


def test_http_answers_head_as_get_without_the_body(http: httpx.Client) -> None:
    for path in ("/v1/tasks", "/v1/tasks/kitting/versions", "/v1/tasks/kitting/3", "/v1/tasks/kitting/3/tree.xml"):
        head, get = http.head(path), http.get(path)
        assert (head.status_code, head.content) == (200, b"")
        assert head.headers["content-length"] == get.headers["content-length"]


@pytest.mark.parametrize(
    ("method", "path", "status", "sentence"),
    [
        ("GET", "/v1/tasks/towers/versions", 404, "no tree 'towers'; stored: kitting"),
        ("GET", "/v1/tasks/kitting/9", 404, "no version of kitting '9'; stored: 1, 2, 3, latest"),
        ("GET", "/v1/tasks/kitting/production/tree.xml", 404, "no version of kitting 'production'"),
        ("GET", "/v1/tasks/kitting/3/tree.png", 404, "stored: tree.xml, tree.json, tree.svg"),
        ("GET", "/v1/tasks/.hidden/3", 400, "task name '.hidden' is refused"),
        ("GET", "/v1/tasks/%2e%2e%2fetc/3", 404, "no form of a tree"),
        ("GET", "/v2", 404, "there is nothing at /v2"),
        ("POST", "/v1/tasks", 405, "POST is refused"),
    ],
)
def test_http_errors_are_one_sentence(http: httpx.Client, method: str, path: str, status: int, sentence: str) -> None:
    answer = http.request(method, path)
    assert answer.status_code == status
    assert list(answer.json()) == ["error"]
    assert sentence in answer.json()["error"]


def test_http_tells_damage_from_absence(http: httpx.Client, store: ArtifactStore) -> None:
    (store.root / "objects" / tree(0.3).digest[:2] / tree(0.3).digest).unlink()
    answer = http.get("/v1/tasks/kitting/3/tree.xml")
    assert answer.status_code == 500
    assert "is gone" in answer.json()["error"]


def test_an_address_that_is_taken_is_named(store: ArtifactStore) -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        pytest.raises(StorageUnavailableError, match="cannot serve HTTP"),
    ):
        StoreOnHttp(store, "127.0.0.1", taken.getsockname()[1])


def test_the_client_is_light() -> None:
    heavy = ("sklearn", "pyarrow", "prefect", "pybullet", "sqlalchemy", "fastapi", "deltalake", "zenoh")
    script = f"import sys, storage.client; print([name for name in {heavy} if name in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True).stdout
    assert loaded.strip() == "[]"
