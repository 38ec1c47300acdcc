"""A Prefect server and the process that runs the flows, started, watched and ended by us. Imports no Prefect."""

from __future__ import annotations

import hashlib
import json
import os
import socket
import sys
import threading
import time
import urllib.error
import urllib.request
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

from pipelines.errors import CommandError, UnreachableError
from pipelines.home import Home
from pipelines.service.child import Child, ChildFailedError

HOST: Final = "127.0.0.1"
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
ASK_S: Final = 60.0
SILENT: Final = {"PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL"}
"""For flows in a command's own process: standard error is for one clear line."""
_OPENER: Final = urllib.request.build_opener(urllib.request.ProxyHandler({}))
"""A server on this machine is never asked through a proxy."""
USUAL_PORT: Final = 4200
FINAL: Final = ("COMPLETED", "FAILED", "CRASHED", "CANCELLED")


class StoppedError(Exception):
    """Told to end while something was still coming up."""


@contextmanager
def prefect_server(
    home: Home, port: int | None, environment: Mapping[str, str], stop: threading.Event
) -> Iterator[tuple[Child, str]]:
    """A server of our own on `port` of this machine with its files in `home.prefect`; yields it and its API's URL.

    Port 0 is any free one; None is Prefect's usual one, or any if that is taken. Raises CommandError if a port that
    was named is in use, ChildFailedError if the server does not come up, StoppedError if `stop` is set meanwhile.
    """
    port = _free_port(port)
    url = f"http://{HOST}:{port}/api"
    own = {
        **QUIET,
        "PREFECT_HOME": str(home.prefect),
        "PREFECT_SERVER_API_HOST": HOST,
        # As an option of the command line alone, the pages would talk to the default port.
        "PREFECT_SERVER_API_PORT": str(port),
        "PREFECT_API_URL": url,
    }
    command = [sys.executable, "-m", "prefect", "server", "start"]
    with Child("Prefect server", command, {**environment, **own}, home.logs / "prefect-server.log") as child:
        _await(child, stop, lambda: answers(url))
        yield child, url


@contextmanager
def flow_runner(
    home: Home, url: str, period_s: float, environment: Mapping[str, str], stop: threading.Event
) -> Iterator[Child]:
    """The process that deploys our flows on the server at `url` and runs them, the refresh every `period_s` [s].

    Raises ChildFailedError and StoppedError as `prefect_server` does.
    """
    own = {**QUIET, "PREFECT_HOME": str(home.prefect), "PREFECT_API_URL": url}
    deployed = f"{url}/deployments/name/refresh/{deployment_name(home)}"
    command = [sys.executable, "-m", "pipelines.flows.deployments", str(home.root), str(period_s)]
    with Child("runner of the flows", command, {**environment, **own}, home.logs / "flows.log") as child:
        _await(child, stop, lambda: _answer(deployed) is not None)
        yield child


def check_api(url: str) -> None:
    """Raises UnreachableError if no Prefect server answers at `url`."""
    if not answers(url):
        raise UnreachableError(
            f"no Prefect server answers at {url}; start `treewright serve`, or unset PREFECT_API_URL to work without"
        )


def answers(url: str) -> bool:
    """Whether a Prefect server answers at `url`."""
    return _answer(f"{url}/health") is True


def deployment_name(home: Home) -> str:
    """What our flows are deployed as: of a data root its own, so that several may share a server."""
    return f"line-{hashlib.sha256(str(home.root).encode()).hexdigest()[:8]}"


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


def _await(child: Child, stop: threading.Event, ready: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + START_S
    while not ready():
        child.check()
        if stop.wait(0.2):
            raise StoppedError
        if time.monotonic() > deadline_s:
            raise ChildFailedError(f"the {child.name} did not come up within {START_S:g} s; see {child.log}")


def _answer(url: str) -> object | None:
    """The JSON at `url`; None where nothing or an error answers."""
    try:
        with _OPENER.open(url, timeout=5) as response:
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
            with _OPENER.open(request, timeout=ASK_S) as response:
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
