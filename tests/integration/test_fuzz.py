"""A little fuzz at every test run: 200 mutated files, and 200 mutated requests to each that answers any."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import httpx
import numpy as np
import pytest
import zenoh
from support_fuzz import WORDS, Answers, mutated, requests, try_files
from support_recorder import CELL, START, network, recording_cell
from support_recordings import object_in_box

from learner.model import SetGripper, Tree
from learner.model.tree import Definition, leaf
from storage.artifacts import ArtifactStore
from storage.client import PREFIX
from storage.http import StoreOnHttp
from storage.serving import StoreOnZenoh

COUNT = 200


def test_mutated_recordings_get_sentences(tmp_path: Path) -> None:
    answers = try_files(object_in_box(1).write(tmp_path / "whole.mcap"), tmp_path, COUNT)
    assert answers.wrong == []
    assert answers.kinds["recovered"] > COUNT / 20
    assert sum(answers.kinds.values()) == 2 * COUNT


def asked(session: zenoh.Session, selector: str, payload: bytes | None, answers: Answers) -> None:
    """Ask, and judge what is answered: something has to be."""
    replies = list(session.get(selector, payload=payload, timeout=20.0))
    assert replies, f"nothing answers {selector!r} {payload!r}"
    for reply in replies:
        sentence = json.loads(reply.err.payload.to_bytes())["error"] if reply.err is not None else ""
        answers.add("refused" if sentence else "answered", sentence)


def test_mutated_requests_to_the_recorder_get_sentences(tmp_path: Path) -> None:
    templates = {
        "start": START,
        "stop": {"outcome": "success"},
        "press": {"type": "pick", "object": "A"},
        "pause": {},
    }
    answers = Answers()
    with recording_cell(tmp_path) as cell:
        for number, (verb, template) in enumerate(templates.items()):
            for payload in requests(template, COUNT // len(templates), seed=number):
                asked(cell.session, f"treewright/{CELL}/recorder/{verb}", payload, answers)
    assert answers.wrong == []
    assert answers.kinds["refused"] > COUNT / 2


@pytest.fixture
def store(tmp_path: Path) -> Iterator[ArtifactStore]:
    with ArtifactStore(tmp_path / "store") as opened:
        opened.publish("kitting", Tree(Definition("Main", leaf(SetGripper("open")))), {})
        yield opened


def test_mutated_requests_to_the_store_get_sentences(store: ArtifactStore) -> None:
    rng, answers = np.random.default_rng(3), Answers()
    plain = (f"{PREFIX}/kitting", f"{PREFIX}/kitting?version=1", f"{PREFIX}/kitting?alias=latest", f"{PREFIX}/*")
    with network() as (ours, theirs), StoreOnZenoh(ours, store):
        while not list(theirs.get(plain[0], timeout=1.0)):
            pass
        for number in range(COUNT):
            name, _, parameters = plain[number % len(plain)].partition("?")
            odd = mutated(parameters.encode(), rng).decode("latin-1") or str(rng.choice(WORDS))
            try:
                zenoh.Selector(f"{name}?{odd}")
            except zenoh.ZError:
                continue  # the network's own library does not let it out
            for reply in theirs.get(f"{name}?{odd}", timeout=5.0):
                sentence = json.loads(reply.err.payload.to_bytes())["error"] if reply.err is not None else ""
                answers.add("refused" if sentence else "answered", sentence)
    assert answers.wrong == []
    assert answers.kinds["refused"] > COUNT / 4


def test_mutated_requests_over_http_get_sentences(store: ArtifactStore) -> None:
    rng, answers = np.random.default_rng(4), Answers()
    paths = ("/v1/tasks", "/v1/tasks/kitting/versions", "/v1/tasks/kitting/1", "/v1/tasks/kitting/1/tree.xml")
    with StoreOnHttp(store, "127.0.0.1", 0) as served, httpx.Client(base_url=served.url, timeout=10.0) as client:
        for number in range(COUNT // 3):
            parts = paths[number % len(paths)].split("/")
            place = int(rng.integers(1, len(parts)))
            parts[place] = quote(mutated(parts[place].encode(), rng) if rng.random() < 0.6 else str(rng.choice(WORDS)))
            response = client.get("/".join(parts), headers={"If-None-Match": str(rng.choice(WORDS)).encode("utf-8")})
            sentence = response.json()["error"] if response.status_code >= 400 else ""
            assert response.status_code < 500, sentence
            answers.add(str(response.status_code), sentence)
    assert answers.wrong == []
