"""Full disks, slow disks, and proof that what counts as durable was synced."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from support_killed_recorder import start_recorder
from support_recorder import (
    CELL,
    PREFIX,
    START,
    Cell,
    Refused,
    advanced_publisher,
    ask,
    configuration,
    free_endpoint,
    recording_cell,
    wait_for,
)

from learner.model import Pose
from recorder.disk import Reserve
from recorder.recording import UNFINISHED, messages, read_header, read_recording, sha256_of
from recorder.recovery import recover

POSES = {"tool0": Pose((0.5, 0.0, 0.3)), "A": Pose((0.5, 0.0, 0.02)), "B": Pose((0.4, 0.1, 0.02))}
STALL_S = 10.0


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 24 MiB."""
    folder = tmp_path / "small"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("a tmpfs cannot be mounted here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def fill(cell: Cell, megabytes: int) -> None:
    """Images that do not compress."""
    with advanced_publisher(cell.session, f"{PREFIX}/image", cache=None) as camera:
        for _ in range(megabytes * 4):
            camera.put(os.urandom(256 << 10))
            cell.put_poses(POSES)


def test_a_disk_that_fills_ends_the_recording_cleanly(small_disk: Path) -> None:
    with recording_cell(small_disk) as cell:
        cell.ask("start", START)
        cell.put_poses(POSES)
        other = Path(cell.ask("stop", {"outcome": "unknown"})["file"])
        digest = sha256_of([other])
        started = cell.ask("start", START)
        stamp_ns = cell.put_poses(POSES)
        cell.press("pick", stamp_ns=stamp_ns, object="A")
        wait_for(lambda: cell.ask("status")["actions_durable"] == 1)
        fill(cell, 30)
        told = cell.await_event("stop", demonstration_id=started["demonstration_id"])
        status = cell.ask("status")
        assert status["state"] == "idle"
        assert "has ended by itself, because the disk fails: No space left on device" in status["alarms"][-1]
        with pytest.raises(Refused, match="cannot stop: nothing is being recorded"):
            cell.ask("stop", {"outcome": "unknown"})
        with pytest.raises(Refused, match="no room to"):
            cell.ask("start", START)
    file = Path(str(started["file"]))
    recording = read_recording([file])
    assert (recording.outcome, len(recording.presses)) == ("unknown", 1)
    assert recording.tracks["A"].stamps_ns[0] == stamp_ns
    images = sum(channel.topic == "/image" for channel, _ in messages(file))
    assert images == told["messages"]["/image"] > 10
    assert 0 < told["lost"]["/image"] <= 120 - images
    assert told["lost"] == read_header(file).messages_lost
    assert sha256_of([other]) == digest
    assert sorted(small_disk.glob("*.mcap*")) == sorted([other, file])


def test_after_a_full_disk_the_recorder_goes_on_when_there_is_room(small_disk: Path) -> None:
    with recording_cell(small_disk) as cell:
        ballast = small_disk / "ballast"
        cell.ask("start", START)
        ballast.write_bytes(bytes(shutil.disk_usage(small_disk).free - (64 << 10)))
        fill(cell, 1)
        cell.await_event("stop")
        ballast.unlink()
        cell.ask("start", START)
        cell.put_poses(POSES)
        assert cell.ask("stop", {"outcome": "unknown"})["messages"]["/poses"] >= 1


def test_a_demonstration_starts_only_if_there_is_room_to_finish_it(small_disk: Path) -> None:
    with recording_cell(small_disk) as cell:
        (small_disk / "ballast").write_bytes(bytes(20 << 20))
        with pytest.raises(Refused, match=r"no room to finish a demonstration .* MiB are free"):
            cell.ask("start", START)
        (small_disk / "ballast").unlink()
        cell.ask("start", START)


def test_the_reserve_is_blocks_and_not_a_promise(small_disk: Path) -> None:
    free = shutil.disk_usage(small_disk).free
    reserve = Reserve(small_disk, 4 << 20)
    assert shutil.disk_usage(small_disk).free <= free - (4 << 20)
    reserve.release()
    assert shutil.disk_usage(small_disk).free == free


def test_an_action_counts_only_after_its_chunk_was_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file system that drops unsynced writes, in effect: at each answer, only what was synced is kept and recovered.

    The page cache survives kill -9 but not a power cut, so killing alone proves nothing about syncing.
    """
    synced: dict[str, int] = {}
    fdatasync = os.fdatasync

    def traced(descriptor: int) -> None:
        name, size = str(Path(f"/proc/self/fd/{descriptor}").readlink()), os.fstat(descriptor).st_size
        time.sleep(0.05)  # a disk takes its time; what is written meanwhile is not synced by this call
        fdatasync(descriptor)
        synced[name] = max(size, synced.get(name, 0))
        if "cut-" not in name:
            threads.add(threading.current_thread().name)

    threads: set[str] = set()
    with recording_cell(tmp_path) as cell:
        monkeypatch.setattr(os, "fdatasync", traced)
        file = Path(cell.ask("start", START)["file"])
        stamps: list[int] = []
        for number in range(1, 11):
            stamps.append(cell.put_poses(POSES))
            cell.press("pick", stamp_ns=stamps[-1])
            cell.put_poses(POSES)
            wait_for(lambda number=number: cell.ask("status")["actions_durable"] >= number)
            after_power_cut = tmp_path / f"cut-{number}.mcap.part"
            unfinished = file.with_name(file.name + UNFINISHED)
            after_power_cut.write_bytes(unfinished.read_bytes()[: synced[str(unfinished)]])
            saved = recover(after_power_cut, tmp_path / f"cut-{number}.mcap").finished.file
            recording = read_recording([saved])
            assert [press.stamp_ns for press in recording.presses][:number] == stamps
            assert set(stamps) <= set(recording.tracks["A"].stamps_ns.tolist())
        cell.ask("stop", {"outcome": "unknown"})
    assert "recorder-sync" in threads
    # The creation of a file is synced by whoever asks for it; nothing on a thread of the network.
    assert threads <= {"recorder-sync", "recorder-control"}


def test_the_kernel_is_really_asked_to_sync(tmp_path: Path) -> None:
    """The system calls themselves, seen by strace: the chunk's write, then fdatasync, then the durable event."""
    if shutil.which("strace") is None:
        pytest.skip("strace is not here")
    endpoint = free_endpoint()
    trace = tmp_path / "trace"
    process = start_recorder(endpoint, tmp_path / "recordings")
    tracer = subprocess.Popen(
        ["strace", "-f", "-y", "-tt", "-e", "trace=write,fdatasync,fsync", "-o", str(trace), "-p", str(process.pid)],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert tracer.stderr is not None
        if "attached" not in tracer.stderr.readline():
            pytest.skip("this process may not be traced")
        with zenoh.open(configuration(connect=endpoint, connect__timeout_ms=20_000)) as session:
            wait_for(lambda: _answers(session), "the recorder")
            ask(session, "start", START)
            session.put(
                f"{PREFIX}/action",
                json.dumps({"stamp_ns": time.time_ns(), "type": "pick"}),
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            wait_for(lambda: ask(session, "status")["actions_durable"] == 1)
    finally:
        tracer.terminate()
        tracer.wait()
        process.kill()
        process.join()
    calls = [line for line in trace.read_text().splitlines() if ".mcap.part>" in line]
    # The last write holds the action's chunk: a sync of the same file comes after it.
    last_write = max(index for index, line in enumerate(calls) if " write(" in line)
    assert any("fdatasync(" in line for line in calls[last_write + 1 :]), calls


def _answers(session: zenoh.Session) -> bool:
    try:
        return bool(ask(session, "status"))
    except (TimeoutError, Refused):
        return False


def test_a_slow_disk_never_stops_the_reading(tmp_path: Path) -> None:
    """A disk that stands still for ten seconds, a thousand messages a second, and 10 MB/s of images beside them."""
    with recording_cell(tmp_path) as cell:
        cell.ask("start", START)
        writing = cell.recorder.machine.take.writing._writer  # type: ignore[union-attr]
        write, stalled = writing._write, time.monotonic() + STALL_S

        def slow(data: bytes) -> None:
            time.sleep(max(0.0, stalled - time.monotonic()))
            write(data)

        writing._write = slow  # type: ignore[method-assign]
        image, count = os.urandom(200_000), round(1000 * STALL_S)
        with (
            advanced_publisher(cell.session, f"{PREFIX}/force", block=False) as force,
            advanced_publisher(cell.session, f"{PREFIX}/image", cache=50, block=False) as camera,
        ):
            for number in range(count):
                force.put(str(number))
                if number % 20 == 0:
                    camera.put(image)
                time.sleep(0.001)
            assert time.monotonic() > stalled
            stopped = cell.ask("stop", {"outcome": "unknown"})
    assert stopped["lost"] == {"/force": 0, "/image": 0}
    numbers = [int(message.data) for _, message in messages(Path(stopped["file"]), frozenset({"/force"}))]
    assert sorted(numbers) == list(range(count))
    assert stopped["messages"]["/image"] == count // 20
    assert read_header(Path(stopped["file"])).cell == CELL
