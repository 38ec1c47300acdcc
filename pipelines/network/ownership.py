"""One owner of a cell, one store of a network: roles that a process holds by a liveliness token, or is refused.

A token below the role's key tells who holds it: `<key>/held/<host>/<process>/<since>/<id>`. Whoever wants the role
first claims it, waits until the claims of others have arrived, and holds it if nobody does and its id is the least of
those that claim it; of two that start at the same moment one wins, whatever their clocks say.
"""

from __future__ import annotations

import os
import re
import socket
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Final

from pipelines.errors import TakenError

if TYPE_CHECKING:
    import zenoh

SETTLE_S: Final = 0.6
"""A claim is known to all that answer within this time [s]."""
LOOK_S: Final = 1.0
"""So long tokens are waited for [s]; they come at once."""


@dataclass(frozen=True, order=True)
class Owner:
    """Who holds or claims a role: a process on a host, since a second of the Unix epoch."""

    id: str
    host: str
    process: int
    since_s: int

    @staticmethod
    def here() -> Owner:
        """This process, from now on."""
        host = re.sub(r"[^A-Za-z0-9._-]", "-", socket.gethostname()) or "unnamed"
        return Owner(uuid.uuid4().hex, host, os.getpid(), int(time.time()))

    @staticmethod
    def of_key(key: str) -> Owner:
        """Who holds the token at a key."""
        host, process, since, name = key.split("/")[-4:]
        return Owner(name, host, int(process), int(since))

    @property
    def chunks(self) -> str:
        """The end of its token's key."""
        return f"{self.host}/{self.process}/{self.since_s}/{self.id}"

    def __str__(self) -> str:
        since = datetime.fromtimestamp(self.since_s).astimezone()
        return f"process {self.process} on {self.host}, since {since:%H:%M:%S}"


@contextmanager
def owned(session: zenoh.Session, key: str, what: str) -> Iterator[Owner]:
    """Hold the role at `key` within the block; `what` names it. Raises TakenError, which says who holds it."""
    me = Owner.here()
    claim = session.liveliness().declare_token(f"{key}/claim/{me.chunks}")
    try:
        token = _held(session, key, what, me)
    finally:
        claim.undeclare()  # type: ignore[no-untyped-call]  # zenoh leaves its return type out
    try:
        yield me
    finally:
        token.undeclare()  # type: ignore[no-untyped-call]  # zenoh leaves its return type out


def _held(session: zenoh.Session, key: str, what: str, me: Owner) -> zenoh.LivelinessToken:
    """The token of the role, for a process that claims it.

    Who claims it after we have looked looks itself no sooner than SETTLE_S later, and then sees our token, if it was
    there in half that time. Where this process was held up meanwhile, it looks again.
    """
    while True:
        time.sleep(SETTLE_S)
        looked_s = time.monotonic()
        holders, claims = _owners(session, f"{key}/held"), _owners(session, f"{key}/claim")
        winner = min([*holders, *([] if holders else claims)], default=me)
        if winner != me:
            raise TakenError(what, str(winner))
        token = session.liveliness().declare_token(f"{key}/held/{me.chunks}")
        if time.monotonic() - looked_s < SETTLE_S / 2:
            return token
        token.undeclare()  # type: ignore[no-untyped-call]  # zenoh leaves its return type out


def _owners(session: zenoh.Session, key: str) -> list[Owner]:
    replies = session.liveliness().get(f"{key}/*/*/*/*", timeout=LOOK_S)
    return sorted(Owner.of_key(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None)
