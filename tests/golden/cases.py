"""The golden cases: each is one set of demonstrations and what is learned from it, told as digests.

A digest stands for each part of what a method returns, so that a change is named by what it touches. `demonstrations`
is the digest of the input: where that changed, it was the simulated demonstrator and not the learner.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from experiments.cells import USERS
from experiments.demonstrator import demonstrated
from experiments.scenarios import SCENARIOS

from learner.errors import LearnerError
from learner.learning import METHODS, learn
from learner.model import Demonstration

FILE: Final = Path(__file__).parent / "digests.json"
PARTS: Final = ("demonstrations", "tree", "report", "notes", "certificate")
QUICKLY_REHEARSED: Final = ("object_in_box", "left_and_right", "moving_reference")
"""The rehearsed cases that every test run can afford; the others are checked by `python -m tests.golden check`."""


@dataclass(frozen=True)
class Case:
    """Demonstrations of a scenario by `users` (a name of the experiments), learned by `method`."""

    scenario: str
    method: str
    users: str
    number: int
    rehearsed: bool = False

    @property
    def key(self) -> str:
        return f"{self.scenario}-{self.method}-{self.users}-{self.number}" + ("-rehearsed" if self.rehearsed else "")

    @property
    def quick(self) -> bool:
        """Whether it is among the cases of every test run."""
        first = self.users == "expert" and self.number == 0
        return first and (not self.rehearsed or self.scenario in QUICKLY_REHEARSED)

    def demonstrate(self) -> list[Demonstration]:
        users = USERS[self.users]
        return demonstrated(SCENARIOS[self.scenario], max(3, SCENARIOS[self.scenario].least), 1000 + self.number, users,
                            each=len(users) > 1)  # fmt: skip

    def digests(self) -> dict[str, str]:
        """The digest of each part; of a refusal to learn, of its sentence."""
        demonstrations = self.demonstrate()
        shown = _digest([asdict(demonstration) for demonstration in demonstrations])
        try:
            learned = learn(demonstrations, method=self.method, rehearsed=self.rehearsed)
        except LearnerError as error:
            return {"demonstrations": shown, "refused": str(error)}
        return {
            "demonstrations": shown,
            "tree": learned.tree.digest[:16],
            "report": _digest(learned.report),
            "notes": _digest(learned.notes),
            "certificate": _digest(learned.certificate),
        }


def _cases() -> Iterator[Case]:
    for scenario in SCENARIOS:
        for method in METHODS:
            yield from (Case(scenario, method, "expert", number) for number in (0, 1))
            yield Case(scenario, method, "real", 2)
        yield Case(scenario, "treewright", "expert", 0, rehearsed=True)
    yield from (Case("tower_and_box", method, "all", 0) for method in METHODS)


CASES: Final = {case.key: case for case in _cases()}


def kept() -> dict[str, dict[str, str]]:
    """The digests as they were written last."""
    found: dict[str, dict[str, str]] = json.loads(FILE.read_text())
    return found


def _digest(value: Any) -> str:
    text = json.dumps(value, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else list(value)
