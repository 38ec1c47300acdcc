"""Recordings over HTTP from recorders elsewhere (see recorder.upload.carrier), for whoever has the token."""

from __future__ import annotations

import hmac
from collections.abc import AsyncIterator, Mapping
from typing import Any, Final

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from pipelines.errors import CommandError
from pipelines.home import TOKEN
from pipelines.steps.arrivals import (
    Arrivals,
    NoRoomError,
    OvertakenError,
    Parcel,
    ParcelRefusedError,
    Received,
    WrongDigestError,
    check_offset,
)

STATUS: Final[dict[type[Exception], int]] = {
    ParcelRefusedError: 400,
    OvertakenError: 409,
    WrongDigestError: 422,
    NoRoomError: 507,
    OSError: 503,
}


def receiving(arrivals: Arrivals, token: str | None) -> APIRouter:
    """The routes by which recordings come. Without a token of ours none is taken."""
    router = APIRouter()

    @router.get("/v1/recordings/{sha256}")
    def received(sha256: str, request: Request) -> Response:
        if refused := _refused(request, token):
            return refused
        try:
            return _answer(arrivals.received(sha256))
        except (CommandError, OSError) as error:
            return _failed(error)

    @router.patch("/v1/recordings/{sha256}")
    async def receive(sha256: str, request: Request) -> Response:
        if refused := _refused(request, token):
            return refused
        try:
            return await _received(arrivals, sha256, request)
        except ClientDisconnect:
            # What came counts; there is nobody left to tell.
            return Response(status_code=400)

    return router


async def _received(arrivals: Arrivals, sha256: str, request: Request) -> Response:
    pieces = request.stream()
    try:
        answer = _answer(await _receive(arrivals, sha256, request.query_params, pieces))
    except (CommandError, OSError) as error:
        answer = _failed(error)
    # Who is still sending does not listen yet.
    async for _ in pieces:
        pass
    return answer


async def _receive(arrivals: Arrivals, sha256: str, told: Mapping[str, str], pieces: AsyncIterator[bytes]) -> Received:
    parcel, offset = Parcel.of(sha256, told), check_offset(told.get("offset", ""))
    received = await run_in_threadpool(arrivals.begin, parcel, offset)
    if received.whole:
        return received
    async for piece in pieces:
        offset = await run_in_threadpool(arrivals.append, parcel, offset, piece) if piece else offset
    return await run_in_threadpool(arrivals.finish, parcel)


def _refused(request: Request, token: str | None) -> Response | None:
    if not token:
        return _error(403, f"this service takes no recordings: it was started without {TOKEN}")
    shown = request.headers.get("authorization", "")
    if not hmac.compare_digest(shown.encode(), f"Bearer {token}".encode()):
        return _error(401, f"the token is not that of this service; set {TOKEN} to the same on both sides")
    return None


def _answer(received: Received) -> Response:
    return JSONResponse({"received_bytes": received.received_bytes, "whole": received.whole})


def _failed(error: CommandError | OSError) -> Response:
    status = next(status for kind, status in STATUS.items() if isinstance(error, kind))
    more = {"received_bytes": error.received_bytes} if isinstance(error, OvertakenError) else {}
    sentence = f"the disk refuses it: {error.strerror or error}" if isinstance(error, OSError) else str(error)
    return _error(status, sentence, **more)


def _error(status: int, sentence: str, **more: Any) -> Response:
    return JSONResponse({"error": sentence, **more}, status)
