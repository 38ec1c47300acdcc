"""The stages of learning, for whoever wants to see them: each is called through `run`, and may tell how far it is.

cluster ──▶ infer ──▶ plan ──▶ rehearse ──▶ prove ──▶ replay
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

Result = TypeVar("Result")


class Stages:
    """Calls each stage, and nothing more. Whoever watches overrides both; what a stage returns is not to be changed."""

    def run(self, name: str, work: Callable[[], Result]) -> Result:
        """Do the work of the stage of this name."""
        return work()

    def progress(self, done: int, most: int) -> None:
        """Be told by the running stage how far it is; it may end before it has done the most that it does."""


UNSEEN: Final = Stages()
