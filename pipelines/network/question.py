"""Questions to queryables that speak JSON: one answer, or one clear sentence why there is none."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any

import zenoh

from pipelines.errors import CommandError, UnreachableError


def ask(session: zenoh.Session, key: str, fields: Mapping[str, Any], timeout_s: float = 10.0) -> dict[str, Any]:
    """The answer of the queryable at `key`, asked once, as soon as it is known on this network.

    Raises CommandError with the sentence of an error reply, UnreachableError if nobody answers in time: an empty
    reply never means success (CONTRACT, section 1).
    """
    with session.declare_querier(key, timeout=timeout_s, congestion_control=zenoh.CongestionControl.BLOCK) as querier:
        await_somebody(querier, time.monotonic() + timeout_s)
        reply = next(iter(querier.get(payload=json.dumps(fields), encoding="application/json")), None)
    if reply is None:
        raise UnreachableError(f"{key} does not answer; is it running, and on this network?")
    if reply.ok is None:
        raise _refusal(key, reply.err)
    answer: dict[str, Any] = json.loads(reply.ok.payload.to_string())
    return answer


def await_somebody(sender: zenoh.Querier | zenoh.Publisher, until_s: float) -> None:
    """Wait until there is somebody to hear `sender`, at most until `until_s` (time.monotonic()).

    A session that was just opened hears of queryables and subscribers a moment later; what it sends before is lost.
    """
    while not _is_matched(sender) and time.monotonic() < until_s:
        time.sleep(0.02)


def _is_matched(sender: zenoh.Querier | zenoh.Publisher) -> bool:
    status: Any = sender.matching_status  # its stub says bool, it is a MatchingStatus
    return bool(status.matching)


def _refusal(key: str, error: zenoh.ReplyError | None) -> CommandError:
    """Ours is {"error": sentence}; Zenoh's own are texts such as 'Timeout'."""
    text = error.payload.to_string() if error is not None else "nothing"
    try:
        return CommandError(str(json.loads(text)["error"]))
    except (ValueError, KeyError, TypeError):
        return UnreachableError(f"{key} does not answer: {text}")
