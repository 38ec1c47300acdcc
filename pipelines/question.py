"""Questions to queryables that speak JSON: one answer, or one clear sentence why there is none."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import zenoh

from pipelines.errors import CommandError, UnreachableError


def ask(session: zenoh.Session, key: str, fields: Mapping[str, Any], timeout_s: float = 10.0) -> dict[str, Any]:
    """The answer of the queryable at `key`.

    Raises CommandError with the sentence of an error reply, UnreachableError if nobody answers in time: an empty
    reply never means success (CONTRACT, section 1).
    """
    replies = session.get(key, payload=json.dumps(fields), encoding="application/json", timeout=timeout_s)
    refusal = None
    for reply in replies:
        if reply.ok is not None:
            answer: dict[str, Any] = json.loads(reply.ok.payload.to_string())
            return answer
        refusal = reply.err.payload.to_string() if reply.err is not None else None
    if refusal:
        raise CommandError(_sentence(refusal, key))
    raise UnreachableError(f"{key} does not answer; is it running, and on this network?")


def _sentence(payload: str, key: str) -> str:
    """The sentence of an error reply: ours is {"error": sentence}, Zenoh's own are texts such as 'Timeout'."""
    try:
        return str(json.loads(payload)["error"])
    except (ValueError, KeyError, TypeError):
        return f"{key} answers with an error: {payload}"
