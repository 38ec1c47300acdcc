"""The access control that ships in docker/security, tried on loopback with certificates made by the script there."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from support_recorder import CELL, PREFIX, START, Refused, advanced_publisher, ask, free_endpoint, wait_for

from learner.model import Pose
from recorder.daemon import Recorder
from recorder.wire import POSES_ENCODING, pose_message

SECURITY = Path("docker/security")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not here")
    folder = tmp_path_factory.mktemp("tls")
    for name, parties in (
        ("ours", ["recorder", "cell", "operator", "controller", "stranger"]),
        ("theirs", ["recorder"]),
    ):
        certify(folder / name, *parties)
    return folder


def certify(folder: Path, *parties: str) -> None:
    """Run the script as its README says."""
    script = ["sh", str(SECURITY / "make-certificates.sh"), str(folder), "localhost", *parties]
    subprocess.run(script, check=True, env={**os.environ, "TREEWRIGHT_CELL": CELL})


@contextlib.contextmanager
def opened(file: str, endpoint: str, tls: Path, party: str | None = None) -> Iterator[zenoh.Session]:
    """A session by a shipped configuration; only the endpoint and the folder of certificates are this machine's."""
    name = file.removesuffix(".json5")
    text = (tls / name / "zenoh.json5").read_text().replace("/etc/treewright/tls", str(tls / (party or name)))
    if party:
        text = text.replace(f"{name}.pem", f"{party}.pem").replace(f"{name}.key", f"{party}.key")
    config = zenoh.Config.from_json5(text)
    config.insert_json5("listen/endpoints" if name == "router" else "connect/endpoints", json.dumps([endpoint]))
    if name != "router":
        config.insert_json5("connect/timeout_ms", "3000")
    with zenoh.open(config) as session:
        yield session


@pytest.fixture
def endpoint() -> str:
    return free_endpoint().replace("tcp/127.0.0.1", "tls/localhost")


def test_the_parties_of_a_cell_can_do_their_work(certificates: Path, endpoint: str, tmp_path: Path) -> None:
    tls = certificates / "ours"
    with (
        opened("router.json5", endpoint, tls),
        opened("recorder.json5", endpoint, tls) as ours,
        opened("cell.json5", endpoint, tls) as cell,
        opened("operator.json5", endpoint, tls) as operator,
        Recorder(ours, CELL, tmp_path),
        advanced_publisher(cell, f"{PREFIX}/poses", encoding=POSES_ENCODING) as poses,
    ):
        wait_for(lambda: answered(operator))
        ask(operator, "start", START)
        poses.put(pose_message(time.time_ns(), "base", {"tool0": Pose((0, 0, 1))}))
        operator.put(f"{PREFIX}/action", json.dumps({"stamp_ns": time.time_ns(), "type": "pick"}))
        wait_for(lambda: ask(operator, "status")["actions_durable"] == 1)
        stopped = ask(operator, "stop", {"outcome": "unknown"})
        assert stopped["messages"] == {"/action": 1, "/poses": 1}
        assert stopped["lost"]["/poses"] == 0


def answered(session: zenoh.Session) -> bool:
    try:
        return bool(ask(session, "status"))
    except (TimeoutError, Refused, ValueError):
        return False


def test_a_stranger_can_neither_publish_poses_nor_start_a_recording(
    certificates: Path, endpoint: str, tmp_path: Path
) -> None:
    """A certificate of the right authority, but of a name in no rule; and a party that oversteps its rule."""
    tls = certificates / "ours"
    with (
        opened("router.json5", endpoint, tls),
        opened("recorder.json5", endpoint, tls) as ours,
        opened("cell.json5", endpoint, tls) as cell,
        opened("operator.json5", endpoint, tls) as operator,
        opened("recorder.json5", endpoint, tls, party="stranger") as stranger,
        Recorder(ours, CELL, tmp_path),
    ):
        wait_for(lambda: answered(operator))
        ask(operator, "start", START)
        message = pose_message(time.time_ns(), "base", {"A": Pose((9, 9, 9))})
        for intruder, key in ((stranger, "poses"), (operator, "poses"), (cell, "action"), (stranger, "action")):
            intruder.put(f"{PREFIX}/{key}", message, congestion_control=zenoh.CongestionControl.BLOCK)
        for intruder in (stranger, cell):
            replies = list(intruder.get(f"{PREFIX}/recorder/stop", payload='{"outcome": "success"}', timeout=1.0))
            assert [reply for reply in replies if reply.ok is not None] == []
        with stranger.liveliness().declare_token(f"{PREFIX}/recorder/alive"):
            operator.put(f"{PREFIX}/action", json.dumps({"stamp_ns": time.time_ns(), "type": "pick"}))
            wait_for(lambda: ask(operator, "status")["actions_durable"] == 1)
        status = ask(operator, "status")
        assert (status["state"], status["messages"]) == ("recording", {"/action": 1})


def test_a_controller_sees_poses_and_uses_skills_but_publishes_nothing(certificates: Path, endpoint: str) -> None:
    tls = certificates / "ours"
    seen: list[bytes] = []
    with (
        opened("router.json5", endpoint, tls),
        opened("cell.json5", endpoint, tls) as cell,
        opened("controller.json5", endpoint, tls) as controller,
        opened("recorder.json5", endpoint, tls) as recorder,
        cell.declare_queryable(f"{PREFIX}/skills/Pick", lambda query: query.reply(query.key_expr, b"done")),
        controller.declare_subscriber(f"{PREFIX}/poses", lambda sample: seen.append(sample.payload.to_bytes())),
    ):
        heard: list[bytes] = []
        with recorder.declare_subscriber(f"{PREFIX}/poses", lambda sample: heard.append(sample.payload.to_bytes())):
            wait_for(lambda: _put(cell, b"by the cell") and b"by the cell" in seen and b"by the cell" in heard)
            _put(controller, b"forged")
            replies = controller.get(f"{PREFIX}/skills/Pick", payload="{}", timeout=5.0)
            assert [reply.ok.payload.to_bytes() for reply in replies if reply.ok] == [b"done"]
            wait_for(lambda: _put(cell, b"by the cell again") and b"by the cell again" in heard)
        assert b"forged" not in heard


def _put(session: zenoh.Session, payload: bytes) -> bool:
    session.put(f"{PREFIX}/poses", payload, congestion_control=zenoh.CongestionControl.BLOCK)
    return True


def test_a_client_of_another_authority_gets_no_connection(certificates: Path, endpoint: str) -> None:
    with (
        opened("router.json5", endpoint, certificates / "ours"),
        pytest.raises(zenoh.ZError),
        opened("recorder.json5", endpoint, certificates / "theirs"),
    ):
        pass


def test_a_client_without_a_certificate_gets_no_connection(certificates: Path, endpoint: str) -> None:
    config = zenoh.Config.from_json5(
        json.dumps(
            {
                "mode": "client",
                "connect": {"endpoints": [endpoint], "timeout_ms": 3000},
                "scouting": {"multicast": {"enabled": False}},
                "transport": {"link": {"tls": {"root_ca_certificate": str(certificates / "ours" / "cell" / "ca.pem")}}},
            }
        )
    )
    with opened("router.json5", endpoint, certificates / "ours"), pytest.raises(zenoh.ZError), zenoh.open(config):
        pass


def test_every_party_has_what_its_container_mounts_and_nothing_of_another(certificates: Path) -> None:
    for party in ("router", "recorder", "cell", "operator", "controller"):
        folder = certificates / "ours" / party
        assert sorted(file.name for file in folder.iterdir()) == sorted(
            ["ca.pem", f"{party}.key", f"{party}.pem", "zenoh.json5"]
        )
        assert "TREEWRIGHT" not in (folder / "zenoh.json5").read_text()
        owners = {file.stat().st_uid for file in (folder, *folder.iterdir())}
        assert owners == ({1000} if os.getuid() == 0 else {os.getuid()})
        assert (folder / f"{party}.key").stat().st_mode & 0o077 == 0
    assert not (certificates / "ours" / "recorder" / "ca.key").exists()


def test_certificates_are_renewed_while_a_recording_runs_and_nothing_is_lost(
    certificates: Path, endpoint: str, tmp_path: Path
) -> None:
    """All files of a cell are made anew, the router comes back with its own, and the clients by themselves."""
    tls = tmp_path / "tls"
    shutil.copytree(certificates / "ours", tls)
    router = contextlib.ExitStack()
    router.enter_context(opened("router.json5", endpoint, tls))
    with (
        router,
        opened("recorder.json5", endpoint, tls) as ours,
        opened("cell.json5", endpoint, tls) as cell,
        opened("operator.json5", endpoint, tls) as operator,
        Recorder(ours, CELL, tmp_path / "recordings"),
        advanced_publisher(cell, f"{PREFIX}/poses", encoding=POSES_ENCODING) as poses,
    ):
        wait_for(lambda: answered(operator))
        ask(operator, "start", START)
        told = 0

        def publish(count: int) -> None:
            nonlocal told
            for _ in range(count):
                poses.put(pose_message(time.time_ns(), "base", {"tool0": Pose((told, 0, 1))}))
                told += 1

        publish(5)
        wait_for(lambda: ask(operator, "status")["messages"].get("/poses") == 5)
        before = (tls / "recorder" / "recorder.pem").read_bytes()
        certify(tls, "recorder", "cell", "operator", "controller")
        assert (tls / "recorder" / "recorder.pem").read_bytes() != before
        router.close()
        publish(5)
        router.enter_context(opened("router.json5", endpoint, tls))
        wait_for(lambda: answered(operator), 30.0)
        publish(5)
        wait_for(lambda: ask(operator, "status")["messages"].get("/poses") == told, 30.0)
        stopped = ask(operator, "stop", {"outcome": "unknown"})
        assert (stopped["messages"]["/poses"], stopped["lost"]["/poses"]) == (15, 0)
