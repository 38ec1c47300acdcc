"""Memory of reading and of replay by what a recording holds: the peak of a process of its own, by kind and size."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from mcap.records import Attachment

from recorder.recording import Demonstrated, RecordingWriter
from recorder.recording.chunks import Batch

SIZES_MB = (50, 400)
PAYLOAD_BYTES = 100_000
TOPICS = 2000
TOOL = {
    "read": "from recorder.recording import messages; from pathlib import Path; "
    "[None for _ in messages(Path(sys.argv[1]))]",
    "replay": "from pipelines.cli import main; "
    "main(['replay', sys.argv[1], '--rate', '1e6', '--wait', '0', '--loop', '2', '--listen', 'tcp/127.0.0.1:0'])",
}
PEAK = "; print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])"


def main() -> None:
    """Print a row for each kind and size."""
    print(f"{'holds':>24} {'size MB':>8} " + " ".join(f"{name + ' MB':>10}" for name in TOOL))
    for kind, write in KINDS.items():
        for size_mb in SIZES_MB:
            with tempfile.TemporaryDirectory(prefix="treewright-bench-") as folder:
                file = Path(folder) / "d.mcap"
                shown = Demonstrated("d", "t", "u", "bench", "base", "tool0", ("A",))
                with RecordingWriter(file, shown) as writer:
                    write(writer, size_mb * 1_000_000)
                    writer.finish()
                peaks = " ".join(f"{peak_mb(code, file):>10}" for code in TOOL.values())
                print(f"{kind:>24} {file.stat().st_size // 1_000_000:>8} {peaks}", flush=True)


def peak_mb(code: str, file: Path) -> int:
    """The most that a process of its own held in memory at once while it did so [MB]."""
    command = [sys.executable, "-c", f"import sys; {code}{PEAK}", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return int(done.stdout.split()[-1]) // 1000


def _one_topic(writer: RecordingWriter, size: int) -> None:
    for number in range(size // PAYLOAD_BYTES):
        writer.write("/camera", os.urandom(PAYLOAD_BYTES), number)


def _many_topics(writer: RecordingWriter, size: int) -> None:
    for number in range(size // PAYLOAD_BYTES):
        writer.write(f"/sensor/{number % TOPICS}", os.urandom(PAYLOAD_BYTES), number)


def _tiny_first(writer: RecordingWriter, size: int) -> None:
    writer.write("/camera", b"", 0)
    _one_topic(writer, size)


def _one_chunk(writer: RecordingWriter, size: int) -> None:
    batch = Batch()
    for number in range(size // PAYLOAD_BYTES):
        batch.add(1, number, number, number, os.urandom(PAYLOAD_BYTES))
    writer.add_channel(1, "/camera", "zenoh/bytes")
    writer.write_batch(batch)


def _attachment(writer: RecordingWriter, size: int) -> None:
    writer.write("/camera", b"small", 0)
    writer.adopt_attachment(Attachment(0, 0, "video", "video/mp4", os.urandom(size)))


KINDS: dict[str, Callable[[RecordingWriter, int], None]] = {
    "one topic": _one_topic,
    f"{TOPICS} topics": _many_topics,
    "a tiny message first": _tiny_first,
    "one chunk": _one_chunk,
    "an attachment": _attachment,
}


if __name__ == "__main__":
    main()
