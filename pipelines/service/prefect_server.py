"""A Prefect server and the process that runs the flows, started, watched and ended by us. Imports no Prefect."""

from __future__ import annotations

import hashlib
import json
import os
import socket
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
import uuid
from collections.abc import Mapping
from typing import Any, Final

from pipelines.errors import CommandError, UnreachableError
from pipelines.home import Home
from pipelines.service.child import Child

HOST: Final = "127.0.0.1"
STORE_HTTP: Final = "TREEWRIGHT_STORE_HTTP"
"""The variable that tells the flows where the store is served, for links to it."""
LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")
START_S: Final = 180.0
"""A cold server needs about 20 s, on a busy machine several times that."""
QUIET: Final = {
    "DO_NOT_TRACK": "1",
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "PREFECT_CLI_PROMPT": "false",
    "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "120",
    # On SQLite a busy server answers 503, which its clients repeat so often.
    "PREFECT_CLIENT_MAX_RETRIES": "20",
}
"""No telemetry, no question: a cell's network may lead nowhere. And patience."""
IMPATIENT: Final = {"PREFECT_CLIENT_MAX_RETRIES": "4"}
"""For flows that are done without a server where that fails: not hours, but half a minute."""
BOUNDED: Final = {
    "PREFECT_SERVER_SERVICES_DB_VACUUM_ENABLED": "events,flow_runs,orphans",
    "PREFECT_SERVER_SERVICES_DB_VACUUM_RETENTION_PERIOD": "2592000",
}
"""The server forgets runs with their logs after 30 days (events after 7); the lake and the store keep what counts."""
ASK_S: Final = 60.0
ANSWER_S: Final = 5.0
SILENT: Final = {"PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL"}
"""For flows in a command's own process: standard error is for one clear line."""
_DIRECT: Final = urllib.request.build_opener(urllib.request.ProxyHandler({}))
USUAL_PORT: Final = 4200
LAST_DEPLOYED: Final = "learn"
DEPLOYED: Final = "line-"
"""How the names of all deployments of ours begin."""
FINAL: Final = ("COMPLETED", "FAILED", "CRASHED", "CANCELLED")


class StoppedError(Exception):
    """Told to end while something was still coming up."""


def prefect_server(home: Home, url: str, environment: Mapping[str, str]) -> Child:
    """A server of our own whose API is at `url`, with its files in `home.prefect`; it is up once it `answers`."""
    port = str(urllib.parse.urlsplit(url).port)
    own = {
        **QUIET,
        **BOUNDED,
        "PREFECT_HOME": str(home.prefect),
        "PREFECT_SERVER_API_HOST": HOST,
        # As an option of the command line alone, the pages would talk to the default port.
        "PREFECT_SERVER_API_PORT": port,
        "PREFECT_API_URL": url,
    }
    command = [sys.executable, "-m", "prefect", "server", "start"]
    return Child("Prefect server", command, {**without_proxy(environment), **own}, home.logs / "prefect-server.log")


def flow_runner(
    home: Home, url: str, store_url: str, period_s: float, learners: int, environment: Mapping[str, str]
) -> Child:
    """The process that ingests and learns what it is told of and what it finds every `period_s` [s], in flows of the
    server at `url` while that answers; the store is served at `store_url`. It says {"ready": true} when it is warm.
    """
    own = {**QUIET, **IMPATIENT, "PREFECT_HOME": str(home.prefect), "PREFECT_API_URL": url, STORE_HTTP: store_url}
    command = [sys.executable, "-m", "pipelines.flows.process", str(home.root), str(period_s), str(learners)]
    name, log = "process of the flows", home.logs / "flows.log"
    return Child(name, command, {**without_proxy(environment), **own}, log, speaks_json=True, listens=True)


def api_url(port: int | None) -> str:
    """Where a server of our own will have its API on this machine.

    Port 0 is any free one; None is Prefect's usual one, or any if that is taken. Raises CommandError if a port that
    was named is in use.
    """
    return f"http://{HOST}:{_free_port(port)}/api"


def without_proxy(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment with what never leads through a proxy: what is on this machine."""
    names = environment.get("no_proxy") or environment.get("NO_PROXY") or ""
    every = ",".join(dict.fromkeys([*filter(None, names.split(",")), *LOOPBACK]))
    return {**environment, "no_proxy": every, "NO_PROXY": every}


def check_api(url: str) -> None:
    """Raises UnreachableError if no Prefect server answers at `url`."""
    if not answers(url):
        raise UnreachableError(
            f"no Prefect server answers at {url}; start `treewright serve`, or unset PREFECT_API_URL to work without"
        )


def answers(url: str) -> bool:
    """Whether a Prefect server answers at `url`."""
    return _answer(f"{url}/health") is True


def is_ready(url: str, patience_s: float = ANSWER_S) -> bool:
    """Whether it answers and reaches its database. Where nobody listens that is known at once."""
    return _answer(f"{url}/ready", patience_s) is not None


def is_deployed(home: Home, url: str) -> bool:
    """Whether the flows of a data root can be asked for on the server at `url`."""
    return _answer(f"{url}/deployments/name/{LAST_DEPLOYED}/{deployment_name(home)}") is not None


def deployment_name(home: Home) -> str:
    """What our flows are deployed as: of a data root its own, so that several may share a server."""
    return f"{DEPLOYED}{hashlib.sha256(str(home.root).encode()).hexdigest()[:8]}"


def run_refresh(home: Home, url: str, timeout_s: float) -> None:
    """Let the server at `url` run the refresh of a data root now, and wait until it is done.

    Raises CommandError with Prefect's words if it does not complete within `timeout_s` [s].
    """
    deployment = _ask(f"{url}/deployments/name/refresh/{deployment_name(home)}")
    # The key makes asking again, after an answer that was lost, the same request.
    wanted = {"state": {"type": "SCHEDULED"}, "idempotency_key": uuid.uuid4().hex}
    run = _ask(f"{url}/deployments/{deployment['id']}/create_flow_run", wanted)
    deadline_s = time.monotonic() + timeout_s
    while run["state_type"] not in FINAL and time.monotonic() < deadline_s:
        time.sleep(0.5)
        run = _ask(f"{url}/flow_runs/{run['id']}")
    if run["state_type"] != "COMPLETED":
        state = run.get("state") or {}
        told = state.get("message") or "its log says more"
        raise CommandError(f"the flow `refresh` is {run['state_type'].lower()} after {timeout_s:g} s at most: {told}")


def run_in_this_process(environment: dict[str, str] | os._Environ[str] = os.environ) -> None:
    """Set up this process for calling a flow: before Prefect is imported, quiet, the server there."""
    check_api(environment["PREFECT_API_URL"])
    for name, value in {**QUIET, **SILENT}.items():
        environment.setdefault(name, value)
    environment.update(without_proxy(environment))


def _open(request: str | urllib.request.Request, timeout_s: float) -> Any:
    """A server on this machine is never asked through a proxy, any other as the environment says."""
    url = request if isinstance(request, str) else request.full_url
    local = urllib.parse.urlsplit(url).hostname in LOOPBACK
    return _DIRECT.open(request, timeout=timeout_s) if local else urllib.request.urlopen(request, timeout=timeout_s)


def _answer(url: str, patience_s: float = ANSWER_S) -> object | None:
    """The JSON at `url`; None where nothing or an error answers."""
    try:
        with _open(url, patience_s) as response:
            document: object = json.loads(response.read())
            return document
    except (urllib.error.URLError, OSError, ValueError):
        return None


def _ask(url: str, document: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The object with which Prefect answers a GET, or with `document` a POST.

    A busy database answers 503 and means: ask again. Raises UnreachableError after ASK_S of that [s].
    """
    data = None if document is None else json.dumps(document).encode()
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"})
    deadline_s = time.monotonic() + ASK_S
    while True:
        try:
            with _open(request, ASK_S) as response:
                answer: dict[str, Any] = json.loads(response.read())
                return answer
        except (urllib.error.URLError, OSError, ValueError) as error:
            if time.monotonic() > deadline_s:
                raise UnreachableError(f"the Prefect server does not answer {url}: {error}") from error
            time.sleep(1.0)


def _free_port(port: int | None) -> int:
    if port is None:
        return USUAL_PORT if _bindable(USUAL_PORT) == USUAL_PORT else _free_port(0)
    found = _bindable(port)
    if found is None:
        raise CommandError(f"the port {port} for the Prefect server is in use; name another with --prefect-port")
    return found


def _bindable(port: int) -> int | None:
    """The port that binding to `port` gives; None if it is taken or cannot be."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except (OSError, OverflowError):
            return None
        return int(probe.getsockname()[1])
