"""A recorder in a process of its own, to be killed."""

from __future__ import annotations

import multiprocessing
import threading
from multiprocessing.process import BaseProcess
from pathlib import Path

_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(["recorder.daemon", "support_recorder"])


def start_recorder(endpoint: str, folder: Path) -> BaseProcess:
    """A recorder that listens on `endpoint` until it is killed."""
    process = _context.Process(target=_serve, args=(endpoint, folder), daemon=True)
    process.start()
    return process


def _serve(endpoint: str, folder: Path) -> None:
    import zenoh
    from support_recorder import CELL, configuration

    from recorder.daemon import Recorder

    with zenoh.open(configuration(listen=endpoint)) as session, Recorder(session, CELL, folder):
        threading.Event().wait()
