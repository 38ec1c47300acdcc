"""The door of the panel on addresses that other machines reach: a token, kept by the browser in a cookie."""

from __future__ import annotations

from html import escape
from typing import Final
from urllib.parse import parse_qs

from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from pipelines.errors import CommandError
from pipelines.panel.access.guard import LOOPBACK, STORE
from pipelines.panel.access.tokens import Person, Tokens
from pipelines.panel.sentences import Voice

COOKIE: Final = "treewright-token"
LANGUAGE: Final = "treewright-language"
MONTH_S: Final = 30 * 24 * 3600
PATH: Final = "/login"
PERSON: Final = "treewright.person"
"""The entry of a request's scope that tells who asks."""
FORM: Final = """<!doctype html><html lang="{language}"><meta name="viewport" content="width=device-width">
<title>treewright</title><body style="font: 18px sans-serif; display: grid; place-content: center; min-height: 90vh">
<form method="post" action="{path}"><p><label>{ask}<br><input name="token" type="password" autofocus
style="font: inherit; width: 18em; max-width: 85vw"></label></p><p role="alert">{said}</p>
<button style="font: inherit; padding: .6em 2em">{enter}</button></form></body></html>"""


class Login:
    """Stands before the application; whoever has no token sees nothing but the question for it."""

    def __init__(self, application: ASGIApp, tokens: Tokens) -> None:
        self._application, self._tokens = application, tokens

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand on who asks, or ask for the token."""
        if scope["type"] not in ("http", "websocket") or scope["path"].startswith(STORE):
            await self._application(scope, receive, send)
            return
        person = self._tokens.person(HTTPConnection(scope).cookies.get(COOKIE, ""))
        if person is not None and scope["path"] != PATH:
            await self._application({**scope, PERSON: person}, receive, send)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": "a token is needed"})
        else:
            response = await self._answer(Request(scope, receive))
            await response(scope, receive, send)

    async def _answer(self, request: Request) -> Response:
        voice = Voice.wanted(request.cookies.get(LANGUAGE), request.headers.get("accept-language", ""))
        if request.url.path != PATH:
            return RedirectResponse(PATH, 303)
        if request.method != "POST":
            return _form(voice, "", 200)
        secret = parse_qs((await request.body()).decode("latin-1")).get("token", [""])[0].strip()
        if self._tokens.person(secret) is None:
            return _form(voice, voice("token_refused"), 403)
        response = RedirectResponse("/", 303)
        encrypted = request.url.scheme == "https"
        response.set_cookie(COOKIE, secret, MONTH_S, httponly=True, samesite="strict", secure=encrypted)
        return response


def needed_on(host: str, tokens: Tokens) -> Tokens | None:
    """The tokens that are asked for on an address: none on those of this machine alone.

    Raises CommandError where some are needed and nobody has one.
    """
    if host in LOOPBACK:
        return None
    if not tokens.all():
        raise CommandError(f"on {host} a token is needed, and nobody has one: `treewright token add NAME --role ROLE`")
    return tokens


def person_of(request: Request) -> Person:
    """Who asks; where nobody has to log in, somebody at this machine."""
    person: Person = request.scope.get(PERSON) or Person()
    return person


def _form(voice: Voice, said: str, status: int) -> HTMLResponse:
    words = {"ask": voice("token_wanted"), "said": said, "enter": voice("token_enter"), "language": voice.language}
    return HTMLResponse(FORM.format(path=PATH, **{name: escape(word) for name, word in words.items()}), status)
