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
from pipelines.panel.desk import Desk
from pipelines.panel.guard import LARGEST_BYTES, Guard
from pipelines.panel.page import PAGES, voice_of
from pipelines.panel.running import RunPage
from pipelines.panel.teach import TeachPage
from pipelines.panel.understand import UnderstandPage

START_S: Final = 20.0
END_S: Final = 10.0


def make_app(desk: Desk) -> FastAPI:
    """The application with the pages of a desk. NiceGUI knows one set of pages, so a process has one panel."""
    app = FastAPI(title="treewright panel", openapi_url=None)

    @ui.page(PAGES["teach"])
    def teach(request: Request, task: str = "") -> None:
        desk.choice.task = task or desk.choice.task
        TeachPage(desk, voice_of(request))

    @ui.page(PAGES["understand"])
    async def understand(request: Request, task: str = "", version: str = "") -> None:
        await UnderstandPage.open(desk, voice_of(request), task, version)

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
    return app


class PanelServer:
    """Serves a desk on `host:port` (port 0: any free one) while the context is open. `url` is where.

    Raises CommandError if the address cannot be used.
    """

    def __init__(self, desk: Desk, host: str, port: int) -> None:
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
            Guard(make_app(desk)),
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
