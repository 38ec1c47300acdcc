"""What a command says: sentences for a person, or JSON for a program (`--json`), never both on standard output."""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class Console:
    """Standard output and standard error of one command."""

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json
        self.make_room: Callable[[], None] = lambda: None
        """Called before a line for a person: what stands on the terminal's last line gives way."""

    def say(self, sentence: str) -> None:
        """A line for a person; with `--json` nothing."""
        if not self.as_json:
            self.make_room()
            print(_printable(sentence), flush=True)

    def emit(self, document: Any) -> None:
        """A JSON document (long-running commands: one object a line) with `--json`; otherwise nothing."""
        if self.as_json:
            print(json.dumps(document, sort_keys=True), flush=True)

    def warn(self, sentence: str) -> None:
        """A line on standard error, with `--json` too."""
        self.make_room()
        print(_printable(f"treewright: {sentence}"), file=sys.stderr, flush=True)

    def fail(self, error: BaseException) -> None:
        """The one line on standard error of a command that failed."""
        text = _sentence(error)
        self.warn(" ".join(text.split()))

    def fail_unexpectedly(self, error: BaseException) -> None:
        """The one line for a defect of ours; TREEWRIGHT_DEBUG=1 shows where it came from."""
        if os.environ.get("TREEWRIGHT_DEBUG"):
            traceback.print_exception(error)
        name = type(error).__name__
        self.warn(" ".join(f"a defect in treewright: {name}: {error} (TREEWRIGHT_DEBUG=1 tells where)".split()))

    def abandon(self) -> int:
        """The reader of standard output is gone: say no more, and keep the interpreter from complaining at exit."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


@contextmanager
def silent_standard_error() -> Iterator[None]:
    """pybullet announces its build time on standard error, which is for one clear line of failure."""
    with Path(os.devnull).open("w") as nowhere:
        kept = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _printable(text: str) -> str:
    """With bytes of file names that are no text escaped."""
    return text.encode("utf-8", "backslashreplace").decode()


def _sentence(error: BaseException) -> str:
    """What an error says; what the operating system refuses is told without its number."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error) or type(error).__name__
