"""Who may ask the panel: pages of its own, on addresses of this machine, and nothing that is too large.

A page of another site that a person has open could send requests to the panel, or let its own name point to this
machine. So whatever names another origin than the panel is refused, and so is a name that is none of this machine's.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Final
from urllib.parse import urlsplit

from starlette.types import ASGIApp, Message, Receive, Scope, Send

LARGEST_BYTES: Final = 1 << 20
"""No request of a page is larger."""
STORE: Final = "/v1/"
LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")
HEADERS: Final = {
    "content-security-policy": (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data:; connect-src 'self'; frame-ancestors 'none'; form-action 'self'; base-uri 'self'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",
}
"""With these a browser loads nothing from elsewhere for our pages, and shows them in no frame of another."""


class Guard:
    """Stands before the application and refuses what is not for it; `hosts` are the names by which it may be asked, any
    where each request is asked who it is of.

    What lies below `/v1/` is the artifact store's, which anybody may read.
    """

    def __init__(self, application: ASGIApp, hosts: tuple[str, ...] | None = LOOPBACK) -> None:
        self._application, self._hosts = application, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse with 403 or 413 and a sentence, or hand on with our headers."""
        if scope["type"] not in ("http", "websocket") or scope["path"].startswith(STORE):
            await self._application(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        refusal = self._refusal(headers)
        if refusal:
            await _refuse(scope, receive, send, *refusal)
        else:
            await self._application(scope, receive, _with_headers(send))

    def _refusal(self, headers: Mapping[str, str]) -> tuple[int, str] | None:
        host = headers.get("host", "")
        if self._hosts is not None and _name_of(f"//{host}") not in self._hosts:
            return 403, f"this panel is not called {host[:80]!r}"
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return 403, f"a page of {origin[:80]!r} may not ask this panel"
        length = headers.get("content-length", "0")
        if not length.isdigit() or int(length) > LARGEST_BYTES:
            return 413, f"a request has at most {LARGEST_BYTES} bytes"
        return None


def _name_of(url: str) -> str | None:
    """The host's name in a URL, None where there is none."""
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            more = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
            message = {**message, "headers": [*message.get("headers", ()), *more]}
        await send(message)

    return sending


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, sentence: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": sentence[:120]})
        return
    body = json.dumps({"error": sentence}).encode()
    headers: list[tuple[Any, Any]] = [(b"content-type", b"application/json")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
