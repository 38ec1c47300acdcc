"""Everything that the learner raises.

LearnerError                        will not pass by trying again
├── ModelError                      a word is malformed
│   ├── NameRefusedError            not a name of the contract
│   └── TreeError                   not a tree of the contract
├── DemonstrationRefusedError       a recording breaks the contract; its reason goes to quarantine
└── NothingLearnedError             the demonstrations do not make a tree
"""

from __future__ import annotations


class LearnerError(Exception):
    """The root: a message of one sentence that names the thing and says what to do."""


class ModelError(LearnerError):
    """A value cannot be what its type says."""


class NameRefusedError(ModelError):
    """A name of a cell, task, user, object, frame or alias that the contract refuses."""

    def __init__(self, kind: str, name: object, rule: str) -> None:
        super().__init__(f"{kind} name {str(name)[:80]!r} is refused: {rule}")
        self.kind, self.name = kind, name


class TreeError(ModelError):
    """A behavior tree outside the vocabulary or the form of the contract, section 3."""


class DemonstrationRefusedError(LearnerError):
    """A recording that breaks the contract: quarantined with this sentence as the reason."""


class NothingLearnedError(LearnerError):
    """No tree follows from these demonstrations."""
