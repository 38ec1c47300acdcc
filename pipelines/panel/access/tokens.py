"""Who may use the panel from other machines: names with a role and the hash of a secret, in a file of the data root.

A token is shown once, when it is made; what is kept tells nobody what it is.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal, cast, get_args

from learner.model import check_name
from pipelines.errors import CommandError

Role = Literal["operator", "engineer"]
ROLES: Final = get_args(Role)
SECRET_BYTES: Final = 24


@dataclass(frozen=True)
class Person:
    """Who uses the panel: an operator teaches and runs, an engineer also judges what was learned.

    On the machine itself nobody logs in: there `name` is empty and is asked for where it is kept.
    """

    name: str = ""
    role: Role = "engineer"

    @property
    def may_judge(self) -> bool:
        """Whether this person approves versions and sets what production runs."""
        return self.role == "engineer"


@dataclass(frozen=True)
class Token:
    """What is kept of a token: since when [ns], and the SHA-256 of its secret."""

    name: str
    role: Role
    since_ns: int
    sha256: str


class Tokens:
    """The tokens in a file, read anew each time: what another process adds or removes counts at once."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def add(self, name: str, role: Role) -> str:
        """Make a token for a name, in place of one that it had; returns its secret.

        Raises NameRefusedError for a name that is none, CommandError for a file that is damaged.
        """
        check_name("user", name)
        secret = secrets.token_urlsafe(SECRET_BYTES)
        token = Token(name, role, time.time_ns(), _hash(secret))
        self._write([*(each for each in self.all() if each.name != name), token])
        return secret

    def remove(self, name: str) -> None:
        """Take a token away. Raises CommandError if there is none of that name."""
        left = [each for each in self.all() if each.name != name]
        if len(left) == len(self.all()):
            names = ", ".join(each.name for each in left) or "none"
            raise CommandError(f"no token is {name!r:.80}'s; there are those of: {names}")
        self._write(left)

    def all(self) -> list[Token]:
        """Every token. Raises CommandError for a file that is damaged."""
        if not self._file.exists():
            return []
        try:
            return [_token(each) for each in json.loads(self._file.read_text())]
        except (ValueError, KeyError, TypeError) as error:
            raise CommandError(f"{self._file} is damaged: {error}; make the tokens anew") from error

    def person(self, secret: str) -> Person | None:
        """Whose token a secret is."""
        digest = _hash(secret)
        found = next((each for each in self.all() if secrets.compare_digest(each.sha256, digest)), None)
        return Person(found.name, found.role) if found else None

    def _write(self, tokens: list[Token]) -> None:
        """Beside, then renamed; readable by its owner alone."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        beside = self._file.with_name(f".{self._file.name}.{secrets.token_hex(4)}.part")
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            with os.fdopen(descriptor, "w") as stream:
                json.dump([asdict(each) for each in tokens], stream)
                stream.flush()
                os.fsync(stream.fileno())
            beside.replace(self._file)
        finally:
            beside.unlink(missing_ok=True)


def _token(data: dict[str, Any]) -> Token:
    if data["role"] not in ROLES:
        raise ValueError(f"a role is {' or '.join(ROLES)}, not {data['role']!r}")
    return Token(str(data["name"]), cast(Role, data["role"]), int(data["since_ns"]), str(data["sha256"]))


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()
