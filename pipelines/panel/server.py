"""The panel on a port: NiceGUI behind the guard, served in a thread while a context is open."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from types import TracebackType
from typing import Final, Self

import uvicorn
from fastapi import FastAPI
from fastapi.responses import JSONResponse
from nicegui import ui
from starlette.requests import Request

from pipelines.errors import CommandError
from pipelines.panel.access.guard import LARGEST_BYTES, Guard
from pipelines.panel.access.login import Login, needed_on, person_of
from pipelines.panel.access.tokens import Tokens
from pipelines.panel.desk import Desk
from pipelines.panel.pages.frame import PAGES, voice_of
from pipelines.panel.pages.running import RunPage
from pipelines.panel.pages.teach import TeachPage
from pipelines.panel.pages.understand import UnderstandPage

START_S: Final = 20.0
BUILD_S: Final = 60.0
"""Patience with reading and unfolding a large tree [s]."""
END_S: Final = 10.0


def with_pages(app: FastAPI, desk: Desk, tokens: Tokens | None = None) -> Guard:
    """The application with the pages of a desk, guarded: for this machine, or with `tokens` for whoever has one.

    NiceGUI knows one set of pages: a process has one panel.
    """

    @ui.page(PAGES["teach"])
    def teach(request: Request, task: str = "") -> None:
        desk.choice.task = task or desk.choice.task
        TeachPage(desk, voice_of(request), person_of(request))

    @ui.page(PAGES["understand"], response_timeout=BUILD_S)
    async def understand(request: Request, task: str = "", version: str = "") -> None:
        await UnderstandPage.open(desk, voice_of(request), person_of(request), task, version)

    @ui.page(PAGES["run"])
    def running(request: Request) -> None:
        RunPage(desk, voice_of(request))

    @app.post("/stop")
    async def stop() -> JSONResponse:
        try:
            await asyncio.to_thread(desk.runs.stop)
        except CommandError as error:
            return JSONResponse({"error": str(error)}, 409)
        return JSONResponse({"stopping": True})

    ui.run_with(app, title="treewright", show_welcome_message=False)
    return Guard(app) if tokens is None else Guard(Login(app, tokens), hosts=None)


class PanelServer:
    """Serves a desk on `host:port` (port 0: any free one) while the context is open. `url` is where.

    On an address that other machines reach a token is needed. Raises CommandError if the address cannot be used, or
    nobody has a token.
    """

    def __init__(self, desk: Desk, host: str, port: int, tokens: Tokens) -> None:
        needed = needed_on(host, tokens)
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._socket = socket.create_server((host, port), family=family)
        except (OSError, OverflowError) as error:
            raise CommandError(f"cannot serve the panel on {host}:{port}: {error}") from error
        # Connections inherit it: a verdict is not to wait for an acknowledgement.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        port = int(self._socket.getsockname()[1])
        self.url = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
        config = uvicorn.Config(
            with_pages(FastAPI(openapi_url=None), desk, needed),
            log_level="warning",
            timeout_graceful_shutdown=1,
            ws_max_size=LARGEST_BYTES,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), name="panel", daemon=True)

    def __enter__(self) -> Self:
        """Returns when it answers. Raises CommandError if it does not come up."""
        self._thread.start()
        end_s = time.monotonic() + START_S
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > end_s:
                raise CommandError(f"the panel on {self.url} did not come up")
            time.sleep(0.02)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.should_exit = True
        self._thread.join(END_S)
        self._socket.close()
