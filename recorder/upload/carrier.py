"""One recording over HTTP, by its digest, going on where it was cut off.

    GET   /v1/recordings/SHA256                                          {"received_bytes", "whole"}
    PATCH /v1/recordings/SHA256?cell=C&name=F&size_bytes=N&offset=K      the bytes from K on; the same answer

With `Authorization: Bearer TOKEN`. What came of a PATCH that broke off counts. 409 answers an offset that is not what
was received, 422 bytes that together have another digest: they are forgotten there. Errors are `{"error": sentence}`.
"""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final
from urllib.parse import urlencode, urlsplit

from recorder.errors import LinkError, RecorderError, UploadRefusedError

PIECE_BYTES: Final = 4 << 20
"""Of one request."""
BLOCK_BYTES: Final = 64 << 10
CONNECT_S: Final = 5.0
"""So long a service may take to be reached at all."""
PATIENCE_S: Final = 30.0
"""So long a block may take, or an answer."""
MOST_STEPS_BACK: Final = 5
"""So often the service may say that it has other bytes than we thought, before that is a failure."""


@dataclass(frozen=True)
class Destination:
    """The service: an http or https URL with nothing behind the port, and the token that it takes."""

    url: str
    token: str

    def __post_init__(self) -> None:
        parts = urlsplit(self.url)
        try:
            told = parts.scheme in ("http", "https") and parts.hostname and (parts.port is None or parts.port > 0)
        except ValueError:
            told = False
        if not told or parts.path not in ("", "/") or parts.query or parts.username:
            raise RecorderError(f"{self.url!r:.120} is no address of a service; write http://HOST:PORT")
        if not self.token.isascii() or not self.token.isprintable() or not self.token:
            raise RecorderError("the token for uploads is empty or has characters that no header holds")


class Carrier:
    """Connects to a service for each file anew: between two of them it would not wait. `interrupt` is for any thread,
    the rest for one.
    """

    def __init__(self, destination: Destination) -> None:
        self._destination = destination
        self._connection: http.client.HTTPConnection | None = None
        self._interrupted = False

    def reach(self) -> None:
        """Raises LinkError where the service cannot be reached."""
        with self._connected():
            pass

    def carry(self, file: Path, cell: str, sha256: str, size_bytes: int) -> None:
        """Until the service has the whole file.

        Raises LinkError for what may pass, UploadRefusedError for what will not, OSError if the file cannot be read.
        """
        with file.open("rb") as stream, self._connected() as connection:
            state, steps_back = self._ask(connection, "GET", sha256), 0
            while not state["whole"]:
                offset = state["received_bytes"]
                place = {"cell": cell, "name": file.name, "size_bytes": size_bytes, "offset": offset}
                state = self._ask(connection, "PATCH", sha256, place, _Piece(stream, offset, size_bytes))
                steps_back += not state["whole"] and state["received_bytes"] <= offset
                if steps_back > MOST_STEPS_BACK:
                    raise LinkError(f"the service at {self._destination.url} takes no more of {file.name}")

    def interrupt(self) -> None:
        """Let whoever is carrying fail at once, now and from now on."""
        self._interrupted = True
        connection = self._connection
        if connection is not None and connection.sock is not None:
            with suppress(OSError):
                connection.sock.shutdown(socket.SHUT_RDWR)

    @contextmanager
    def _connected(self) -> Iterator[http.client.HTTPConnection]:
        """A connection; what breaks it off is a LinkError."""
        parts = urlsplit(self._destination.url)
        kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        connection = kind(str(parts.hostname), parts.port, timeout=CONNECT_S)
        try:
            connection.connect()
            connection.sock.settimeout(PATIENCE_S)
            self._connection = connection
            if self._interrupted:
                raise LinkError("the recorder ends")
            yield connection
        except (OSError, http.client.HTTPException) as error:
            reason = (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
            raise LinkError(f"the service at {self._destination.url} cannot be reached: {reason}") from error
        finally:
            self._connection = None
            connection.close()

    def _ask(
        self,
        connection: http.client.HTTPConnection,
        method: str,
        sha256: str,
        place: Mapping[str, object] | None = None,
        piece: _Piece | None = None,
    ) -> dict[str, Any]:
        target = f"/v1/recordings/{sha256}" + (f"?{urlencode(place)}" if place else "")
        headers = {"Authorization": f"Bearer {self._destination.token}"}
        if piece is not None:
            headers |= {"Content-Length": str(piece.length), "Content-Type": "application/octet-stream"}
        connection.request(method, target, piece, headers)
        response = connection.getresponse()
        return self._understood(response.status, response.read())

    def _understood(self, status: int, body: bytes) -> dict[str, Any]:
        try:
            answer = json.loads(body)
            sentence = answer.get("error")
            if status == 409 or sentence is None:
                return {"received_bytes": int(answer["received_bytes"]), "whole": answer.get("whole") is True}
        except (ValueError, KeyError, TypeError, AttributeError):
            sentence = f"what it answers with status {status} is not understood"
        told = f"the service at {self._destination.url} takes no recording: {sentence}"
        raise UploadRefusedError(told) if status in (400, 401, 403, 404, 405) else LinkError(told)


class _Piece:
    """A piece of a file from an offset on, read as it is sent. Refuses to send less than it said."""

    def __init__(self, stream: IO[bytes], offset: int, size_bytes: int) -> None:
        self._stream, self._offset = stream, offset
        self.length = max(min(PIECE_BYTES, size_bytes - offset), 0)

    def __iter__(self) -> Iterator[bytes]:
        self._stream.seek(self._offset)
        left = self.length
        while left:
            block = self._read(min(BLOCK_BYTES, left))
            left -= len(block)
            yield block

    def _read(self, size_bytes: int) -> bytes:
        """Raises LinkError, so that nobody takes a failure of the disk for one of the link."""
        try:
            block = self._stream.read(size_bytes)
        except OSError as error:
            raise LinkError(f"{self._stream.name} cannot be read: {error.strerror}") from error
        if not block:
            raise LinkError(f"{self._stream.name} became shorter while it was sent")
        return block
