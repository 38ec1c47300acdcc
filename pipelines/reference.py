"""`T[@V]` on the command line: a task, and which version of its tree (CONTRACT, section 4)."""

from __future__ import annotations

from typing import NamedTuple

from learner.model.names import check_alias, check_name
from pipelines.errors import CommandError


class Reference(NamedTuple):
    """A task with a version, an alias, or neither (`production` if set, else `latest`)."""

    task: str
    version: int | None = None
    alias: str | None = None

    @staticmethod
    def parse(text: str) -> Reference:
        """Raises NameRefusedError for names that the contract refuses, CommandError for a version that cannot be."""
        task, at, chosen = text.partition("@")
        check_name("task", task)
        if not at:
            return Reference(task)
        if not (chosen.isascii() and chosen.isdigit()):
            return Reference(task, alias=check_alias(chosen))
        if int(chosen) < 1:
            raise CommandError(f"{text} names version {chosen}, but versions are counted from 1")
        return Reference(task, version=int(chosen))

    def __str__(self) -> str:
        chosen = self.alias if self.version is None else self.version
        return self.task if chosen is None else f"{self.task}@{chosen}"
