"""What a controller needs of a served store: fetch a tree over Zenoh and check that it is what was published.

Light on purpose: importing it loads no database, no table format and no learning library.
"""

from __future__ import annotations

import hashlib
import json
import time
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from learner.model.names import check_alias, check_name
from storage.btcpp import from_xml
from storage.errors import DamagedError, NotStoredError, StorageUnavailableError, WrittenTreeError

if TYPE_CHECKING:
    import zenoh

PREFIX: Final = "treewright/artifacts"
TIMEOUT_S: Final = 5.0
ASK_AGAIN_S: Final = 0.1


class Fetched(NamedTuple):
    """A tree as BehaviorTree.CPP XML, and its manifest; both checked."""

    xml: str
    manifest: dict[str, Any]


class RefusedByStoreError(NotStoredError):
    """The served store answered with an error: its own sentence."""

    def __init__(self, sentence: str) -> None:
        Exception.__init__(self, sentence)


def fetch(
    session: zenoh.Session,
    task: str,
    version: int | None = None,
    alias: str | None = None,
    timeout_s: float = TIMEOUT_S,
) -> Fetched:
    """The tree of `task` by version or alias; without either, production if set, else latest.

    Checked before it is returned: the digest of the XML's bytes and of the tree in it against the manifest, and the
    manifest against what was asked for. Where several stores answer, the first good answer counts.

    Raises StorageUnavailableError if no store answers within `timeout_s` [s], RefusedByStoreError with the store's
    sentence if it has no such tree, DamagedError if what came is not what was published, NameRefusedError for a name
    that the contract refuses.
    """
    check_name("task", task)
    chosen = {"version": version, "alias": None if alias is None else check_alias(alias)}
    parameters = ";".join(f"{name}={value}" for name, value in chosen.items() if value is not None)
    deadline_s = time.monotonic() + timeout_s
    while (left_s := deadline_s - time.monotonic()) > 0:
        refusal: str | None = None
        for reply in session.get(f"{PREFIX}/{task}?{parameters}".rstrip("?"), timeout=left_s):
            if reply.ok is not None:
                return _checked(reply.ok, task, version)
            refusal = refusal or _refusal(reply.err)
        if refusal:
            raise RefusedByStoreError(refusal)
        # A session that was just opened does not know yet who answers what.
        time.sleep(ASK_AGAIN_S)
    raise StorageUnavailableError(
        f"no artifact store answers on {PREFIX}/{task} within {timeout_s:g} s; "
        "start `treewright serve`, or name its endpoint with --connect"
    )


def _checked(sample: zenoh.Sample, task: str, version: int | None) -> Fetched:
    try:
        xml = sample.payload.to_bytes().decode()
        manifest = json.loads(sample.attachment.to_bytes()) if sample.attachment is not None else None
    except ValueError as error:
        raise DamagedError(f"the answer for {task} is damaged: {error}") from error
    if not isinstance(manifest, dict):
        raise DamagedError(f"the answer for {task} comes without a manifest")
    asked = {"task": task, "version": manifest.get("version") if version is None else version}
    for name, value in asked.items():
        if manifest.get(name) != value:
            raise DamagedError(f"asked for {name} {value} of {task}, the store answered with {manifest.get(name)}")
    check_xml(xml, manifest)
    return Fetched(xml, manifest)


def check_xml(xml: str, manifest: dict[str, Any]) -> None:
    """Whether `xml` is the tree of which the manifest tells. Raises DamagedError."""
    name = f"{manifest.get('task')}@{manifest.get('version')}"
    if hashlib.sha256(xml.encode()).hexdigest() != manifest.get("xml_sha256"):
        raise DamagedError(f"the XML of {name} does not have the digest that its manifest states")
    try:
        digest = from_xml(xml).digest
    except WrittenTreeError as error:
        raise DamagedError(f"the XML of {name} is refused: {error}") from error
    if digest != manifest.get("digest"):
        raise DamagedError(f"the tree of {name} does not have the digest that its manifest states")


def _refusal(error: zenoh.ReplyError | None) -> str | None:
    """The sentence of a store; None for the network's own errors, such as a timeout."""
    try:
        return str(json.loads(error.payload.to_bytes())["error"]) if error is not None else None
    except (ValueError, KeyError, TypeError):
        return None
