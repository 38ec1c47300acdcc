"""One open recording on its way to the disk: a thread that writes chunks, and one that makes them durable."""

from __future__ import annotations

import contextlib
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final

from recorder.disk import Reserve
from recorder.intake.waiting import Intake
from recorder.recording import Demonstrated, Finished, RecordingWriter
from recorder.recording.chunks import Batch

CHUNK_S: Final = 0.1
"""A chunk closes after so long even if little came."""
SYNC_S: Final = 0.1
"""Between two syncs, unless an action waits for one."""

Channels = Callable[[int], tuple[str, str]]
"""From a channel's number to its topic and Zenoh encoding."""


class Writing:
    """Takes from its `intake` until that is closed. A disk that fails ends it: see `error`.

    `on_durable` is called, on the syncing thread, when an action has become durable; `on_error` once, on the writing
    thread, if the disk fails.
    """

    def __init__(
        self,
        file: Path,
        demonstrated: Demonstrated,
        channels: Channels,
        limit_bytes: int,
        on_durable: Callable[[int], None],
        on_error: Callable[[OSError], None],
    ) -> None:
        self.intake = Intake(limit_bytes)
        self.error: OSError | None = None
        self.unwritten: Counter[str] = Counter()
        self.actions_durable = 0
        self._channels, self._on_durable, self._on_error = channels, on_durable, on_error
        self._reserve = Reserve(_made(file.parent))
        self._writer = _opened(file, demonstrated, self._reserve)
        self._dirty, self._ended = threading.Event(), threading.Event()
        self._urgent = threading.Event()
        self._failing = threading.Lock()
        self._actions_written = 0
        self._threads = [
            threading.Thread(target=run, name=name, daemon=True)
            for run, name in ((self._write, "recorder-write"), (self._sync, "recorder-sync"))
        ]
        for thread in self._threads:
            thread.start()

    @property
    def file(self) -> Path:
        """Where the recording will be when it is whole."""
        return self._writer.file

    @property
    def size_bytes(self) -> int:
        """Bytes on disk and on the way there."""
        return self._writer.size_bytes + self.intake.waiting_bytes

    def drain(self) -> None:
        """Write all that was taken in, and let both threads end."""
        self.intake.close()
        for thread in self._threads:
            thread.join()

    def finish(self, demonstrated: Demonstrated) -> Finished:
        """Close durably what `drain` has written, also after the disk has failed: then the reserve is given back.

        Raises OSError if even that fails; the file then stays unfinished, whole up to its last chunk.
        """
        self.drain()
        self._reserve.release()
        with self._writer:
            return self._writer.finish(demonstrated)

    def discard(self) -> None:
        """Take the recording off the disk."""
        self.drain()
        self._reserve.release()
        with self._writer:
            self._writer.unfinished.unlink(missing_ok=True)

    def _write(self) -> None:
        while (batch := self.intake.take(CHUNK_S)) is not None:
            if not len(batch):
                continue
            if self.error is None:
                self._write_chunk(batch)
            else:
                self._count_unwritten(batch)
        self._ended.set()
        self._dirty.set()
        self._urgent.set()

    def _write_chunk(self, batch: Batch) -> None:
        try:
            for channel in set(batch.channels):
                self._writer.add_channel(channel, *self._channels(channel))
            self._writer.write_batch(batch)
        except OSError as error:
            self._count_unwritten(batch)
            self._fail(error)
            return
        self._actions_written += batch.actions
        if batch.actions:
            self._urgent.set()
        self._dirty.set()

    def _count_unwritten(self, batch: Batch) -> None:
        for channel, count in Counter(batch.channels).items():
            self.unwritten[self._channels(channel)[0]] += count

    def _fail(self, error: OSError) -> None:
        with self._failing:
            first, self.error = self.error is None, self.error or error
        if first:
            self._on_error(error)

    def _sync(self) -> None:
        while True:
            self._dirty.wait()
            self._dirty.clear()
            self._urgent.clear()
            actions, ended = self._actions_written, self._ended.is_set()
            if self.error is None:
                self._sync_once(actions)
            if ended:
                return
            self._urgent.wait(SYNC_S)

    def _sync_once(self, actions: int) -> None:
        try:
            self._writer.sync()
        except OSError as error:
            self._fail(error)
            return
        if actions > self.actions_durable:
            self.actions_durable = actions
            self._on_durable(actions)


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _opened(file: Path, demonstrated: Demonstrated, reserve: Reserve) -> RecordingWriter:
    with contextlib.ExitStack() as undo:
        undo.callback(reserve.release)
        writer = RecordingWriter(file, demonstrated)
        undo.pop_all()
    return writer
