"""Jobs for a worker's process, which imports them by name."""

from __future__ import annotations

import os
import time
from pathlib import Path

from pipelines.errors import TakenError
from pipelines.flows.worker import tell_news


def echo(word: str) -> str:
    """The word, and who says it."""
    return f"{word} {os.getpid()}"


def tell_and_wait(file: str) -> str:
    """Tell news, and be done once there is a file."""
    tell_news()
    while not Path(file).exists():
        time.sleep(0.01)
    return "done"


def fail() -> str:
    """Raise what does not survive being sent between processes."""
    raise TakenError("the oven", "a cake")


def die() -> str:
    """End the process as a fault in a library does."""
    os._exit(7)


def hang() -> str:
    """Wait for longer than any test."""
    time.sleep(600)
    return "never"
