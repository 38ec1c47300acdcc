"""Zenoh sessions are opened here and handed down: from options, the environment, or a configuration file."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from pipelines.errors import CommandError, UnreachableError

if TYPE_CHECKING:
    import zenoh

PATIENCE_MS: Final = 10_000
RETRY_MS: Final = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 1.5}


def add_zenoh_arguments(parser: argparse.ArgumentParser) -> None:
    """The three options of every command that talks Zenoh (CONTRACT, section 4)."""
    group = parser.add_argument_group("Zenoh")
    group.add_argument("--connect", action="append", metavar="EP", help="endpoint to connect to (TREEWRIGHT_CONNECT)")
    group.add_argument("--listen", action="append", metavar="EP", help="endpoint to listen on (TREEWRIGHT_LISTEN)")
    group.add_argument("--zenoh-config", metavar="FILE", help="configuration file (TREEWRIGHT_ZENOH_CONFIG)")


def zenoh_words(arguments: argparse.Namespace) -> list[str]:
    """The words that lead another command to the same network; what the environment says, it is told too."""
    endpoints = arguments.connect or arguments.listen or []
    words = [word for endpoint in endpoints for word in ("--connect", endpoint)]
    return words + (["--zenoh-config", arguments.zenoh_config] if arguments.zenoh_config else [])


@contextmanager
def open_session(
    arguments: argparse.Namespace, environment: Mapping[str, str] = os.environ, mode: str | None = None
) -> Iterator[zenoh.Session]:
    """An open session, closed at the end of the block.

    Options win over the environment (lists separated by commas), which wins over the configuration file. Where an
    endpoint is named, multicast scouting is off: the network is what was named. Who only connects is a client, which
    listens nowhere: a peer would, on all interfaces, and strangers with it; who it connects to may be about to start,
    so it tries for ten seconds. Who listens is a router, through which its clients reach each other. `mode` ('peer',
    'client', 'router') overrides this and the configuration's.

    Raises CommandError for a configuration that Zenoh refuses, UnreachableError if an endpoint does not answer.
    """
    import zenoh

    if environment.get("RUST_LOG"):
        # Only on request: Zenoh's log goes to standard output, where --json promises one document and nothing else.
        zenoh.init_log_from_env_or("error")
    connect, listen = (
        getattr(arguments, name) or [part for part in environment.get(variable, "").split(",") if part]
        for name, variable in (("connect", "TREEWRIGHT_CONNECT"), ("listen", "TREEWRIGHT_LISTEN"))
    )
    file = arguments.zenoh_config or environment.get("TREEWRIGHT_ZENOH_CONFIG")
    try:
        config = zenoh.Config.from_file(file) if file else zenoh.Config()
        config.insert_json5("timestamping/enabled", "true")
        if connect or listen:
            config.insert_json5("connect/endpoints", json.dumps(connect))
            config.insert_json5("listen/endpoints", json.dumps(listen))
            config.insert_json5("scouting/multicast/enabled", "false")
            config.insert_json5("mode", json.dumps("router" if listen else "client"))
            config.insert_json5("connect/timeout_ms", json.dumps({"client": PATIENCE_MS}))
            config.insert_json5("connect/retry", json.dumps(RETRY_MS))
        if mode:
            config.insert_json5("mode", json.dumps(mode))
    except (zenoh.ZError, OSError) as error:
        where = f"the configuration {file}" if file else f"the endpoints {[*connect, *listen]}"
        raise CommandError(f"Zenoh refuses {where}: {error}") from error
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        named = ", ".join([*connect, *listen]) or "the network"
        # What Zenoh appends is a line of its own source.
        reason = str(error).partition(" at /")[0]
        raise UnreachableError(f"cannot open a Zenoh session on {named}: {reason}") from error
    with session:
        yield session
