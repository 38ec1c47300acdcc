"""Jobs for a worker's process, which imports them by name."""

from __future__ import annotations

import os
import time

from pipelines.errors import TakenError


def echo(word: str) -> str:
    """The word, and who says it."""
    return f"{word} {os.getpid()}"


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
