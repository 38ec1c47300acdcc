"""Where requests to the recorder are taken in, and answered one after the other."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

import zenoh

from recorder.daemon.requests import parse_request
from recorder.daemon.voice import Voice
from recorder.errors import RecorderError
from recorder.wire import JSON_ENCODING, json_message

Fulfil = Callable[[str, Mapping[str, Any]], dict[str, Any]]
"""From a verb and its request to the reply. Raises RecorderError or OSError where there is to be an error reply."""


class Desk:
    """Answers all requests below a key, as a context; what is under way when it ends is done first.

    One thread does all that changes anything, in the order in which it came: requests, and the work of `submit`. The
    status is answered on another, so that it can be had at any time. `fence` returns when all samples that came
    before a request have been taken in.
    """

    def __init__(
        self, session: zenoh.Session, key: str, fence: Callable[[], None], fulfil: Fulfil, voice: Voice
    ) -> None:
        self._session, self._key, self._fence, self._fulfil, self._voice = session, key, fence, fulfil, voice
        self._requests: queue.SimpleQueue[tuple[str, zenoh.Query] | Callable[[], None] | None] = queue.SimpleQueue()
        self._status_requests: queue.SimpleQueue[zenoh.Query | None] = queue.SimpleQueue()
        self._opened = ExitStack()
        self._threads = [
            threading.Thread(target=run, name=f"recorder-{name}", daemon=True)
            for name, run in (("control", self._control), ("status", self._answer_status))
        ]

    def __enter__(self) -> Self:
        self._opened.enter_context(self._session.declare_queryable(f"{self._key}*", self._asked))
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._requests.put(None)
        self._status_requests.put(None)
        for thread in self._threads:
            thread.join()
        self._opened.close()

    def submit(self, work: Callable[[], None]) -> None:
        """Have something done between two requests. Never waits."""
        self._requests.put(work)

    def _asked(self, query: zenoh.Query) -> None:
        """Take a request from the receiving thread; never wait there."""
        verb = str(query.key_expr).removeprefix(self._key)
        if verb == "status":
            self._status_requests.put(query)
        else:
            self._requests.put((verb, query))

    def _control(self) -> None:
        while (request := self._requests.get()) is not None:
            if callable(request):
                self._do(request)
            else:
                self._answer(*request)

    def _do(self, work: Callable[[], None]) -> None:
        try:
            work()
        except (RecorderError, OSError) as error:
            self._voice.alarm(sentence_of(error))
        except Exception as error:  # noqa: BLE001  # whatever one message brought up, the next request is answered
            self._voice.alarm(f"a defect of the recorder: {type(error).__name__}: {error}")

    def _answer_status(self) -> None:
        while (query := self._status_requests.get()) is not None:
            self._answer("status", query)

    def _answer(self, verb: str, query: zenoh.Query) -> None:
        with query:
            try:
                request = parse_request(verb, query.payload.to_bytes() if query.payload else b"")
                self._fence()
                reply = self._fulfil(verb, request)
            except (RecorderError, OSError) as error:
                query.reply_err(json_message({"error": sentence_of(error)}), encoding=JSON_ENCODING)
            except Exception as error:  # noqa: BLE001  # an empty reply would look like no recorder at all
                sentence = f"a defect of the recorder at the request {verb}: {type(error).__name__}: {error}"
                self._voice.alarm(sentence)
                query.reply_err(json_message({"error": sentence}), encoding=JSON_ENCODING)
            else:
                query.reply(f"{self._key}{verb}", json_message(reply), encoding=JSON_ENCODING)


def sentence_of(error: BaseException) -> str:
    """An error as one sentence."""
    if isinstance(error, OSError) and error.strerror:
        return f"the disk refuses {error.filename or 'the recording'}: {error.strerror}"
    return str(error) or type(error).__name__
