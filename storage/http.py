"""The artifact store over HTTP (CONTRACT, section 5). Errors are `{"error": sentence}`."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Any, Final, Self

import uvicorn
from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp

from learner.errors import LearnerError
from storage.artifacts import Artifact, ArtifactStore, sha256_of
from storage.errors import DamagedError, DoubtfulError, NotStoredError, StorageError, StorageUnavailableError
from storage.picture import to_svg

Handler = Callable[[Request, Exception], JSONResponse]
Extend = Callable[[FastAPI], ASGIApp]

FORMATS: Final[dict[str, tuple[str, Callable[[Artifact], str]]]] = {
    "tree.xml": ("application/xml", lambda artifact: artifact.xml),
    "tree.json": ("application/json", lambda artifact: artifact.tree_json),
    "tree.svg": ("image/svg+xml", lambda artifact: to_svg(artifact.tree)),
}
STATUS: Final[dict[type[Exception], int]] = {
    NotStoredError: 404,
    DoubtfulError: 404,
    LearnerError: 400,  # a name that the contract refuses
    StorageUnavailableError: 503,
    DamagedError: 500,
    StorageError: 500,
}
READ: Final = ["GET", "HEAD"]
START_S: Final = 10.0


def make_app(store: ArtifactStore, others: Iterable[APIRouter] = ()) -> FastAPI:
    """The application that answers from `store`: tasks, versions, manifests and trees, read-only; and `others`."""
    app = FastAPI(title="treewright artifacts", openapi_url=None)

    @app.api_route("/v1/tasks", methods=READ)
    def tasks() -> JSONResponse:
        return JSONResponse(store.tasks())

    @app.api_route("/v1/tasks/{task}/versions", methods=READ)
    def versions(task: str) -> JSONResponse:
        return JSONResponse(store.versions(task))

    @app.api_route("/v1/tasks/{task}/{ref}", methods=READ)
    def manifest(task: str, ref: str, request: Request) -> Response:
        text = store.get(task, ref).served_json
        return _answer(request, text, "application/json", sha256_of(text))

    @app.api_route("/v1/tasks/{task}/{ref}/{name}", methods=READ)
    def tree(task: str, ref: str, name: str, request: Request) -> Response:
        if name not in FORMATS:
            raise NotStoredError("form of a tree", name, FORMATS)
        media_type, render = FORMATS[name]
        artifact = store.get(task, ref)
        return _answer(request, render(artifact), media_type, artifact.digest)

    for router in others:
        app.include_router(router)
    for kind, status in STATUS.items():
        app.add_exception_handler(kind, _handler(status))
    app.add_exception_handler(HTTPException, _refused_by_framework)
    app.add_exception_handler(Exception, _defect)
    return app


class StoreOnHttp:
    """Serves `store`, and what `others` answer, on `host:port` (port 0: any free one) in a thread of this context.

    `url` is where; `extend` makes of the application one that serves more. Raises StorageUnavailableError if an address
    cannot be used.
    """

    def __init__(
        self,
        store: ArtifactStore,
        host: str,
        port: int,
        others: Iterable[APIRouter] = (),
        extend: Extend | None = None,
    ) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._socket = socket.create_server((host, port), family=family)
        except (OSError, OverflowError) as error:
            raise StorageUnavailableError(f"cannot serve HTTP on {host}:{port}: {error}") from error
        # Connections inherit it. Else a small answer's body waits 40 ms for the reader to acknowledge its head.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.port = int(self._socket.getsockname()[1])
        self.url = f"http://[{host}]:{self.port}" if ":" in host else f"http://{host}:{self.port}"
        app = make_app(store, others)
        config = uvicorn.Config(
            extend(app) if extend else app,
            log_level="warning",
            lifespan="on" if extend else "off",
            timeout_graceful_shutdown=2,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), name="http", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.should_exit = True
        self._thread.join(START_S)
        self._socket.close()


def _answer(request: Request, text: str, media_type: str, digest: str) -> Response:
    headers = {"ETag": f'"{digest}"', "Cache-Control": "no-cache"}
    if _matches(request.headers.get("if-none-match", ""), digest):
        return Response(status_code=304, headers=headers)
    return Response(text, media_type=media_type, headers=headers)


def _matches(if_none_match: str, digest: str) -> bool:
    """Weak comparison, as RFC 9110 asks of If-None-Match."""
    tags = [tag.strip().removeprefix("W/") for tag in if_none_match.split(",")]
    return "*" in tags or f'"{digest}"' in tags


def _handler(status: int) -> Handler:
    def handle(_: Request, error: Exception) -> JSONResponse:
        return _error(status, str(error))

    return handle


def _refused_by_framework(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)  # it is registered for no other
    sentences = {404: f"there is nothing at {request.url.path}", 405: f"{request.method} is refused; the store is read"}
    return _error(error.status_code, sentences.get(error.status_code, str(error.detail)), error.headers)


def _defect(_: Request, error: Exception) -> JSONResponse:
    return _error(500, f"a defect in the artifact store: {type(error).__name__}: {error}")


def _error(status: int, sentence: str, headers: Any = None) -> JSONResponse:
    return JSONResponse({"error": " ".join(sentence.split())}, status, headers)
