"""Who may use the panel from other machines: tokens with roles, asked for before anything is shown."""

from __future__ import annotations

import asyncio
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.types import Receive, Scope, Send

from learner.errors import NameRefusedError
from pipelines.cli import main
from pipelines.errors import CommandError
from pipelines.panel.access.login import COOKIE, PERSON, Login, needed_on
from pipelines.panel.access.tokens import Person, Tokens


@pytest.fixture
def tokens(tmp_path: Path) -> Tokens:
    return Tokens(tmp_path / "home" / "tokens.json")


def test_a_token_tells_who_it_is_and_the_file_does_not_tell_the_token(tokens: Tokens, tmp_path: Path) -> None:
    secret = tokens.add("ann", "operator")
    assert tokens.person(secret) == Person("ann", "operator")
    assert tokens.person(secret + "x") is None
    assert tokens.person("") is None
    file = tmp_path / "home" / "tokens.json"
    assert secret not in file.read_text()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_a_new_token_of_a_name_takes_the_place_of_the_old_one(tokens: Tokens) -> None:
    old, new = tokens.add("ann", "operator"), tokens.add("ann", "engineer")
    assert tokens.person(old) is None
    assert tokens.person(new) == Person("ann", "engineer")


def test_a_token_that_was_taken_away_counts_no_more(tokens: Tokens) -> None:
    kept, gone = tokens.add("ann", "operator"), tokens.add("bob", "engineer")
    tokens.remove("bob")
    assert (tokens.person(gone), tokens.person(kept)) == (None, Person("ann", "operator"))
    with pytest.raises(CommandError, match="ann"):
        tokens.remove("bob")


@pytest.mark.parametrize("name", ["", "a b", "<script>", "../x"])
def test_a_name_that_is_none_gets_no_token(tokens: Tokens, name: str) -> None:
    with pytest.raises(NameRefusedError):
        tokens.add(name, "operator")
    assert tokens.all() == []


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", '[{"name": "a"}]', '[{"name":"a","role":"king","since_ns":1,"sha256":""}]']
)
def test_a_damaged_file_lets_nobody_in_and_is_named(tokens: Tokens, tmp_path: Path, text: str) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "tokens.json").write_text(text)
    with pytest.raises(CommandError, match=r"tokens\.json"):
        tokens.person("x")


def test_other_addresses_than_the_loopback_need_somebody_with_a_token(tokens: Tokens) -> None:
    assert needed_on("127.0.0.1", tokens) is None
    with pytest.raises(CommandError, match="token add"):
        needed_on("0.0.0.0", tokens)
    tokens.add("ann", "operator")
    assert needed_on("0.0.0.0", tokens) is tokens


def test_the_command_adds_lists_and_removes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TREEWRIGHT_HOME", str(tmp_path))
    assert main(["token", "add", "ann", "--role", "operator"]) == 0
    secret = capsys.readouterr().out.split()[-1]
    assert Tokens(tmp_path / "tokens.json").person(secret) == Person("ann", "operator")
    assert main(["token", "list"]) == 0
    assert capsys.readouterr().out.startswith("ann  operator  since ")
    assert main(["token", "remove", "ann"]) == 0
    assert main(["token", "remove", "ann"]) == 1


async def application(scope: Scope, receive: Receive, send: Send) -> None:
    person = scope.get(PERSON)
    body = (person.name if person else "nobody").encode()
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": body})


def asked(
    tokens: Tokens, method: str, path: str, cookies: Mapping[str, str] | None = None, **more: Any
) -> httpx.Response:
    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(Login(application, tokens))
        async with httpx.AsyncClient(
            transport=transport, base_url="http://panel", cookies=dict(cookies or {})
        ) as client:
            return await client.request(method, path, **more)

    return asyncio.run(ask())


@pytest.mark.parametrize(("method", "path"), [("GET", "/"), ("GET", "/run"), ("POST", "/stop"), ("GET", "/_nicegui/x")])
def test_without_a_token_there_is_nothing_but_the_question_for_it(tokens: Tokens, method: str, path: str) -> None:
    tokens.add("ann", "operator")
    for cookies in ({}, {COOKIE: "wrong"}):
        response = asked(tokens, method, path, cookies)
        assert (response.status_code, response.headers["location"]) == (303, "/login")
    assert 'name="token"' in asked(tokens, "GET", "/login").text
    assert asked(tokens, "GET", "/v1/tasks").text == "nobody"


def test_a_token_opens_the_door_and_is_kept_where_no_script_reads_it(tokens: Tokens) -> None:
    secret = tokens.add("ann", "operator")
    opened = asked(tokens, "POST", "/login", data={"token": f" {secret} "})
    assert (opened.status_code, opened.headers["location"]) == (303, "/")
    cookie = opened.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert asked(tokens, "GET", "/", {COOKIE: secret}).text == "ann"


def test_a_wrong_token_is_refused_in_the_persons_language(tokens: Tokens) -> None:
    tokens.add("ann", "operator")
    response = asked(tokens, "POST", "/login", data={"token": "<b>"}, headers={"Accept-Language": "de"})
    assert response.status_code == 403
    assert "kein Schlüssel" in response.text
    assert "<b>" not in response.text


def test_a_stream_without_a_token_is_closed_before_it_opens(tokens: Tokens) -> None:
    sent: list[Any] = []

    async def receive() -> Any:
        return {"type": "websocket.connect"}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(Login(application, tokens)({"type": "websocket", "path": "/x", "headers": []}, receive, send))
    assert [message["type"] for message in sent] == ["websocket.close"]
