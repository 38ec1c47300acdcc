"""What a command may end with: one clear sentence on standard error, exit code 1.

    CommandError                         what the command line itself refuses
    ├── UnreachableError                 may pass: a peer does not answer
    ├── CellRefusedError                 a cell lacks what a tree needs
    ├── TakenError                       another process has the role that this one wants
    └── ...                              each package's own root error counts too: see `covers`

An exception that is none of these is a defect, and the command says so.
"""

from __future__ import annotations

import sys


class CommandError(Exception):
    """The root: a message of one sentence that names the thing and says what to do."""

    @staticmethod
    def covers(error: BaseException) -> bool:
        """Whether `error` is a failure that a person should read as one sentence."""
        roots: list[type[BaseException]] = [CommandError, OSError]
        for name, root in (
            ("learner.errors", "LearnerError"),
            ("recorder.errors", "RecorderError"),
            ("storage.errors", "StorageError"),
        ):
            # An error of a package that was never imported cannot have been raised.
            if name in sys.modules:
                roots.append(getattr(sys.modules[name], root))
        return isinstance(error, tuple(roots))


class UnreachableError(CommandError):
    """A recorder, cell or store does not answer; trying again later may help."""


class TakenError(CommandError):
    """Another process has the role that this one wants; `owner` says which."""

    def __init__(self, what: str, owner: str) -> None:
        super().__init__(f"{what} is running already: {owner}; end it first")


class CellRefusedError(CommandError):
    """A cell lacks an object, a frame or a skill that the tree needs; nothing was moved."""
