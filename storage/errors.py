"""Everything that storage raises.

StorageError
├── WrittenTreeError           a text is no tree in the XML of the contract, section 3
├── NotStoredError             what was asked for is not there; the message says what is
├── ConflictError              a demonstration's id is taken by other content
├── RelabelRefusedError        a correction that the demonstrated action cannot take
├── AliasRefusedError          a doubtful tree gets no alias but doubtful; what is not doubted needs no approval
├── DoubtfulError              a task has only a doubtful tree, which is used by that name alone
├── ManifestRefusedError       facts about a tree that would contradict the store's own
├── DamagedError               stored bytes are not those that were stored
└── StorageUnavailableError    may pass: a database, folder or served store does not answer now
"""

from __future__ import annotations

from collections.abc import Iterable


class StorageError(Exception):
    """The root: a message of one sentence that names the thing and says what to do."""


class WrittenTreeError(StorageError):
    """A text that is no behavior tree of the contract, section 3."""


class NotStoredError(StorageError):
    """Nothing is stored under this name; `stored` is what is."""

    def __init__(self, what: str, name: object, stored: Iterable[object]) -> None:
        known = [str(entry) for entry in stored]
        shown = ", ".join(known[:10]) + (f" and {len(known) - 10} more" if len(known) > 10 else "")
        super().__init__(f"no {what} {str(name)[:80]!r}; stored: {shown or 'none'}")
        self.name = name


class ConflictError(StorageError):
    """The id of a demonstration is taken by other content: to quarantine, with this sentence as the reason."""

    def __init__(self, demonstration_id: str, sha256: str, stored_sha256: str) -> None:
        super().__init__(
            f"demonstration {demonstration_id!r} is already stored with other content "
            f"(sha256 {stored_sha256[:12]}, not {sha256[:12]}); give this recording another id"
        )
        self.demonstration_id = demonstration_id


class RelabelRefusedError(StorageError):
    """A correction of an action's type that its other facts contradict."""


class AliasRefusedError(StorageError):
    """An alias that a tree may not get."""


class DoubtfulError(StorageError):
    """There is no tree of a task but a doubtful one, which is taken only by that name or once it is approved."""

    def __init__(self, task: str, version: int) -> None:
        super().__init__(
            f"{task} has only a doubtful tree, {task}@{version}; take it as {task}@doubtful, or "
            f"`treewright approve {task}@{version} --by NAME` after a look at its doubts"
        )


class ManifestRefusedError(StorageError):
    """Facts that cannot go into a manifest."""


class DamagedError(StorageError):
    """Stored bytes do not have the digest under which they are stored."""


class StorageUnavailableError(StorageError):
    """A database, a folder or a served store does not answer; trying again later may help."""
