"""What a recording says of itself: its metadata record (CONTRACT, section 2)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, cast

from learner.model import Scene
from recorder.errors import NotARecordingError

CONTRACT: Final = "1"
DEMONSTRATION: Final = "treewright.demonstration"
"""The name of the metadata record."""


@dataclass(frozen=True)
class Demonstrated:
    """The metadata record of a recording: what was demonstrated, by whom, where, and how it ended.

    `part` numbers the parts of a split demonstration from 1; `continued` says that another part follows. `scene` is
    the JSON text of the contract. `more` holds every further entry of the record, kept as it is.
    """

    demonstration_id: str
    task: str
    user: str
    cell: str
    base_frame: str
    end_effector_frame: str
    objects: tuple[str, ...]
    outcome: str = "unknown"
    start_ns: int | None = None
    messages_lost: Mapping[str, int | None] | None = None
    part: int | None = None
    continued: bool = False
    scene: str | None = None
    gaps: tuple[str, ...] = ()
    more: Mapping[str, str] = field(default_factory=dict)

    def to_metadata(self) -> dict[str, str]:
        """The entries of the record, all strings."""
        optional = {
            "start_ns": self.start_ns,
            "messages_lost": None if self.messages_lost is None else json.dumps(self.messages_lost, sort_keys=True),
            "part": self.part,
            "continued": "true" if self.continued else None,
            "scene": self.scene,
            "gaps": json.dumps(self.gaps) if self.gaps else None,
        }
        return {
            **self.more,
            "contract": CONTRACT,
            **{name: getattr(self, name) for name in _REQUIRED_STRINGS},
            "objects": json.dumps(self.objects),
            **{name: str(value) for name, value in optional.items() if value is not None},
        }

    @staticmethod
    def from_metadata(file: Path, metadata: Mapping[str, str]) -> Demonstrated:
        """The record as read from `file`. Raises NotARecordingError for what the contract does not admit."""
        missing = [name for name in ("contract", *_REQUIRED_STRINGS, "objects") if name not in metadata]
        if missing:
            raise NotARecordingError(file, f"its record {DEMONSTRATION} lacks {', '.join(missing)}")
        if metadata["contract"] != CONTRACT:
            raise NotARecordingError(
                file, f"it keeps version {metadata['contract']!r} of the contract; this program knows {CONTRACT}"
            )
        return Demonstrated(
            **{name: metadata[name] for name in _REQUIRED_STRINGS},
            objects=_names(file, metadata["objects"]),
            start_ns=_whole_number(file, "start_ns", metadata.get("start_ns")),
            messages_lost=_lost(file, metadata.get("messages_lost")),
            part=_whole_number(file, "part", metadata.get("part")),
            continued=metadata.get("continued") == "true",
            scene=metadata.get("scene") or None,
            gaps=_sentences(metadata.get("gaps")),
            more={name: text for name, text in metadata.items() if name not in _KNOWN},
        )


_REQUIRED_STRINGS: Final = (
    "demonstration_id", "task", "user", "cell", "base_frame", "end_effector_frame", "outcome",
)  # fmt: skip
_KNOWN: Final = {
    "contract", *_REQUIRED_STRINGS, "objects", "start_ns", "messages_lost", "part", "continued", "scene", "gaps",
}  # fmt: skip


def _json(file: Path, what: str, text: str | bytes) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise NotARecordingError(file, f"{what} is not JSON: {error}") from error


def _names(file: Path, text: str) -> tuple[str, ...]:
    names = _json(file, "`objects` of its record", text)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise NotARecordingError(file, f"`objects` of its record is not a JSON array of names: {text[:80]}")
    return tuple(names)


def _whole_number(file: Path, name: str, text: str | None) -> int | None:
    if not text:
        return None
    if not text.isascii() or not text.isdigit() or int(text) >= 2**63:
        raise NotARecordingError(file, f"`{name}` of its record is not a whole number: {text[:80]!r}")
    return int(text)


def _lost(file: Path, text: str | None) -> dict[str, int | None] | None:
    if not text:
        return None
    lost = _json(file, "`messages_lost` of its record", text)
    counts = isinstance(lost, dict) and all(count is None or type(count) is int for count in lost.values())
    if not counts:
        raise NotARecordingError(file, f"`messages_lost` of its record does not count by topic: {text[:80]}")
    return cast(dict[str, int | None], lost)


def _sentences(text: str | None) -> tuple[str, ...]:
    """Our own addition to the record; another writer may mean anything by the word, so it is never refused."""
    try:
        sentences = json.loads(text or "[]")
    except ValueError:
        return (text or "",)
    return tuple(map(str, sentences)) if isinstance(sentences, list) else (str(sentences),)


def parse_scene(text: str) -> Scene:
    """The scene of the contract, section 2. Raises ValueError with what is wrong with it."""
    try:
        return Scene.of_data(json.loads(text))
    except (json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"the scene is not as the contract's section 2 has it: {error}") from error
