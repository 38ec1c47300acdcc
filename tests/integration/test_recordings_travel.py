"""Recordings travel from a recorder's machine to the service: two data roots, links that are cut, services that end."""

from __future__ import annotations

import hashlib
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from support_processes import command, daemon
from support_recorder import CELL, START, free_endpoint, recording_cell, wait_for
from support_recordings import object_in_box

from pipelines.home import Home
from pipelines.service.receiving import receiving
from pipelines.steps.arrivals import Arrivals
from pipelines.steps.ingest import ingest
from recorder.daemon import Options
from recorder.errors import LinkError, RecorderError, UploadRefusedError
from recorder.recording import sha256_of
from recorder.upload.carrier import Carrier, Destination
from recorder.upload.outbox import Outbox
from storage.artifacts import ArtifactStore
from storage.http import StoreOnHttp
from storage.lake import Lake

TOKEN = "a-token-of-both"
LARGE = 12 << 20


class Link:
    """A TCP link to a port that passes on so many bytes in all, and is cut then; `mend` lets it pass again."""

    def __init__(self, port: int, limit: float = float("inf")) -> None:
        self.port_behind, self.limit, self.passed = port, limit, 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def mend(self) -> None:
        self.limit = float("inf")

    def close(self) -> None:
        self._listener.close()
        self._cut()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                self._join(self._listener.accept()[0])

    def _join(self, here: socket.socket) -> None:
        try:
            if self.passed >= self.limit:
                raise ConnectionAbortedError
            behind = socket.create_connection(("127.0.0.1", self.port_behind))
        except OSError:
            here.close()
            return
        self._open += [here, behind]
        for source, target, counted in ((here, behind, True), (behind, here, False)):
            threading.Thread(target=self._pass, args=(source, target, counted), daemon=True).start()

    def _pass(self, source: socket.socket, target: socket.socket, counted: bool) -> None:
        with suppress(OSError):
            while data := source.recv(1 << 16):
                self.passed += len(data) if counted else 0
                if self.passed >= self.limit:
                    break
                target.sendall(data)
        if counted and self.passed >= self.limit:
            self._cut()
        target.close()

    def _cut(self) -> None:
        for each in self._open:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)


@contextmanager
def link(port: int, limit: float = float("inf")) -> Iterator[Link]:
    made = Link(port, limit)
    try:
        yield made
    finally:
        made.close()


@contextmanager
def service(
    root: Path, port: int = 0, token: str | None = TOKEN, arrived: Callable[[Path], None] = lambda file: None
) -> Iterator[int]:
    """A service that takes recordings into a data root; the port on which it answers."""
    with ArtifactStore(root / "store") as store:
        routes = receiving(Arrivals(Home(root), arrived), token)
        with StoreOnHttp(store, "127.0.0.1", port, [routes]) as http:
            yield http.port


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A file that takes several requests, and its digest."""
    file = tmp_path_factory.mktemp("cell") / "large.mcap"
    file.write_bytes(bytes(range(256)) * (LARGE // 256))
    return file, sha256_of([file])


def carry(url: str, file: Path, sha256: str) -> None:
    Carrier(Destination(url, TOKEN)).carry(file, "bench", sha256, file.stat().st_size)


def test_an_upload_goes_on_where_the_link_was_cut_though_the_service_was_started_again(
    tmp_path: Path, large: tuple[Path, str]
) -> None:
    file, sha256 = large
    arrived: list[Path] = []
    with (
        service(tmp_path, arrived=arrived.append) as port,
        link(port, limit=7 << 20) as cut,
        pytest.raises(LinkError, match="cannot be reached"),
    ):
        carry(cut.url, file, sha256)
    assert not arrived
    assert not list(tmp_path.rglob("*.mcap"))
    with service(tmp_path, arrived=arrived.append) as port, link(port) as mended:
        carry(mended.url, file, sha256)
        assert mended.passed < LARGE - (6 << 20)
        carry(mended.url, file, sha256)
    assert arrived == [Home(tmp_path).recordings / "bench" / "large.mcap"]
    assert sha256_of(arrived) == sha256
    assert not list(Home(tmp_path).arriving.glob("*.part"))


def test_a_service_that_is_killed_midway_has_the_recording_in_the_end(tmp_path: Path, large: tuple[Path, str]) -> None:
    """`serve` is a process of its own; what it was given goes to ingest, whatever it is."""
    there = Home(tmp_path / "service")
    whole, (cut_off, sha256) = object_in_box(3).write(tmp_path / "cell" / "3.mcap"), large
    port, options = int(free_endpoint().rpartition(":")[2]), ("--listen", "tcp/127.0.0.1:0")
    with daemon(
        there.root, "serve", "--store-only", "--http", f"127.0.0.1:{port}", *options, TREEWRIGHT_TOKEN=TOKEN
    ) as up:
        assert up.hear() == {"ready": True}
        assert up.hear()["event"] == "serving"
        carry(f"http://127.0.0.1:{port}", whole, sha256_of([whole]))
        received = up.hear()
        with link(port, limit=7 << 20) as cut, pytest.raises(LinkError):
            carry(cut.url, cut_off, sha256)
        up.end(signal.SIGKILL)
    assert (received["event"], received["cell"]) == ("received", "bench")
    assert (there.arriving / f"{sha256}.part").stat().st_size >= 4 << 20
    with pytest.raises(LinkError, match="refused"):
        carry(f"http://127.0.0.1:{port}", cut_off, sha256)
    with service(there.root, port):
        carry(f"http://127.0.0.1:{port}", cut_off, sha256)
    result = ingest(there, Lake(there.lake))
    assert (len(result.ingested), len(result.quarantined)) == (1, 1)


def upload_to(port: int) -> Options:
    return Options(upload_to=Destination(f"http://127.0.0.1:{port}", TOKEN))


def test_the_status_says_what_waits_until_the_service_has_it(tmp_path: Path) -> None:
    """The service comes late, and the recorder ends and begins again before it does."""
    folder, there = tmp_path / "cell" / CELL, Home(tmp_path / "service")
    port = int(free_endpoint().rpartition(":")[2])
    with recording_cell(folder, upload_to(port)) as cell:
        assert cell.ask("status")["uploads"] == {"waiting": 0, "waiting_bytes": 0, "reason": None}
        cell.ask("start", START)
        cell.put_poses({})
        stopped = cell.ask("stop", {"outcome": "success"})
        size = Path(stopped["file"]).stat().st_size
        wait_for(lambda: cell.ask("status")["uploads"]["reason"])
        waits = cell.ask("status")["uploads"]
        assert (waits["waiting"], waits["waiting_bytes"]) == (1, size)
        assert "Connection refused" in waits["reason"]
        cell.await_event("alarm", alarm=waits["reason"])
    with recording_cell(folder, upload_to(port)) as cell:
        assert cell.ask("status")["uploads"]["waiting"] == 1
        with service(there.root, port):
            told = cell.await_event("uploaded", sha256=stopped["sha256"])
            assert cell.ask("status")["uploads"] == {"waiting": 0, "waiting_bytes": 0, "reason": None}
    (arrived,) = there.recordings.rglob("*.mcap")
    assert sha256_of([arrived]) == stopped["sha256"]
    assert sha256_of([Path(told["file"])]) == stopped["sha256"], "nothing is deleted"
    assert not Outbox(folder, lambda: None).waiting()


def test_parts_of_a_demonstration_travel_after_its_end_and_are_one_demonstration_there(tmp_path: Path) -> None:
    folder, there = tmp_path / "cell" / CELL, Home(tmp_path / "service")
    with service(there.root) as port, recording_cell(folder, upload_to(port)) as cell:
        cell.ask("start", START)
        cell.put_poses({})
        cell.ask("split")
        assert list(folder.glob("*.mcap"))
        time.sleep(0.2)  # what would travel now, would have begun to
        assert not list(there.root.rglob("*.mcap"))
        cell.ask("discard")
        cell.ask("start", START)
        cell.ask("split")
        stopped = cell.ask("stop", {"outcome": "success"})
        wait_for(lambda: cell.ask("status")["uploads"]["waiting"] == 0)
    arrived = {file.name for file in there.recordings.rglob("*.mcap")}
    assert arrived == {Path(part).name for part in stopped["parts"]}


@pytest.fixture(scope="module")
def taking(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """A data root, and where its service answers."""
    root = tmp_path_factory.mktemp("service")
    with service(root) as port:
        yield root, f"http://127.0.0.1:{port}/v1/recordings"


def put(url: str, content: bytes, sha256: str | None = None, token: str = TOKEN, **told: Any) -> httpx.Response:
    sha256 = sha256 or hashlib.sha256(content).hexdigest()
    parameters = {"cell": "bench", "name": "a.mcap", "size_bytes": len(content), "offset": 0, **told}
    headers = {"Authorization": f"Bearer {token}"}
    return httpx.patch(f"{url}/{sha256}", params=parameters, content=content, headers=headers)


@pytest.mark.parametrize(
    ("told", "status", "word"),
    [
        ({"name": "../../a.mcap"}, 400, "no name of a recording"),
        ({"name": "a.txt"}, 400, "no name of a recording"),
        ({"cell": ".."}, 400, "cell"),
        ({"cell": "artifacts"}, 400, "reserved"),
        ({"size_bytes": 0}, 400, "size_bytes"),
        ({"size_bytes": "9" * 14}, 507, "no room"),
        ({"size_bytes": 3}, 400, "more have come"),
        ({"offset": -1}, 400, "offset"),
        ({"offset": 2}, 409, "0 bytes have come"),
        ({"sha256": "A" * 64}, 400, "SHA-256"),
        ({"sha256": "0" * 64}, 422, "other bytes"),
        ({"token": "another"}, 401, "token"),
    ],
)
def test_what_is_wrong_about_an_upload_is_one_sentence_and_leaves_nothing(
    taking: tuple[Path, str], told: dict[str, Any], status: int, word: str
) -> None:
    root, url = taking
    answer = put(url, b"12345678", **told)
    assert answer.status_code == status
    assert word in answer.json()["error"]
    assert not list(root.rglob("*.mcap"))
    assert not list(Home(root).arriving.glob("*.part"))


def test_a_service_without_a_token_takes_nothing(tmp_path: Path, large: tuple[Path, str]) -> None:
    file, sha256 = large
    with (
        service(tmp_path, token=None) as port,
        pytest.raises(UploadRefusedError, match="started without TREEWRIGHT_TO"),
    ):
        carry(f"http://127.0.0.1:{port}", file, sha256)


def test_two_recordings_of_one_name_are_both_kept(tmp_path: Path) -> None:
    home = Home(tmp_path)
    with service(tmp_path) as port:
        for content in (b"one", b"other", b"one"):
            answer = put(f"http://127.0.0.1:{port}/v1/recordings", content)
            assert answer.json() == {"received_bytes": len(content), "whole": True}
    assert sorted(file.read_bytes() for file in home.recordings.rglob("*.mcap")) == [b"one", b"other"]


def test_bytes_that_came_damaged_are_forgotten_and_sent_again(tmp_path: Path, large: tuple[Path, str]) -> None:
    """As a power cut at the service leaves them: as long as they were, but other ones."""
    file, sha256 = large
    part = Home(tmp_path).arriving / f"{sha256}.part"
    part.parent.mkdir(parents=True)
    part.write_bytes(bytes(9 << 20))
    with service(tmp_path) as port:
        with pytest.raises(LinkError, match="other bytes"):
            carry(f"http://127.0.0.1:{port}", file, sha256)
        carry(f"http://127.0.0.1:{port}", file, sha256)
    assert sha256_of(list(Home(tmp_path).recordings.rglob("*.mcap"))) == sha256


def test_two_that_bring_the_same_recording_at_once_do_not_spoil_it(tmp_path: Path, large: tuple[Path, str]) -> None:
    file, sha256 = large
    arrived: list[Path] = []
    failures: list[Exception] = []

    def bring() -> None:
        while True:
            try:
                carry(f"http://127.0.0.1:{port}", file, sha256)
            except LinkError as error:
                failures.append(error)
                continue
            return

    with service(tmp_path, arrived=arrived.append) as port:
        both = [threading.Thread(target=bring) for _ in range(2)]
        for each in both:
            each.start()
        for each in both:
            each.join()
    assert len(arrived) == 1, failures
    assert sha256_of(arrived) == sha256


def test_a_recording_that_is_changed_is_sent_once_more(tmp_path: Path) -> None:
    """Such as one that was recovered under its name."""
    (tmp_path / "a.mcap").write_bytes(b"one")
    outbox = Outbox(tmp_path, lambda: None)
    (parcel,) = outbox.waiting()
    outbox.confirm(parcel, "0" * 64)
    assert not outbox.waiting()
    assert not Outbox(tmp_path, lambda: None).waiting()
    (tmp_path / "a.mcap").write_bytes(b"other")
    assert [each.name for each in Outbox(tmp_path, lambda: None).waiting()] == ["a.mcap"]


@pytest.mark.parametrize(
    "url", ["service:8420", "ftp://service", "http://", "http://service:0", "http://a/b", "http://u@a"]
)
def test_an_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(RecorderError, match="is no address of a service"):
        Destination(url, TOKEN)


def test_a_recorder_without_the_token_says_so(tmp_path: Path) -> None:
    done = command(tmp_path, "record", "--cell", "c", "--upload", "http://127.0.0.1:1", "--listen", "tcp/127.0.0.1:0")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "set TREEWRIGHT_TOKEN" in line
