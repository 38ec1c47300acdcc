"""Which finished recordings of a folder the service has, and which it does not have yet.

Beside the recordings, in `.uploaded/`, lies what was confirmed, a JSON file a recording; who deletes it has the
recording sent once more, which changes nothing at the service.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from recorder.durable import whole

CONFIRMED: Final = ".uploaded"
RECORDING: Final = ".mcap"


@dataclass(frozen=True)
class Parcel:
    """A finished recording as it lay there when it was looked at: size [bytes], last change [ns]."""

    name: str
    size_bytes: int
    changed_ns: int

    @staticmethod
    def of(file: Path) -> Parcel:
        """Raises OSError."""
        status = file.stat()
        return Parcel(file.name, status.st_size, status.st_mtime_ns)


class Outbox:
    """The finished recordings in a folder. `held_back` names the demonstration whose parts do not travel yet."""

    def __init__(self, folder: Path, held_back: Callable[[], str | None]) -> None:
        self.folder, self._held_back = folder, held_back
        self._confirmed: set[Parcel] = set()

    def waiting(self) -> list[Parcel]:
        """What is not confirmed as it lies there now, the oldest first."""
        held_back = self._held_back()
        files = [file for file in self.folder.glob(f"*{RECORDING}") if held_back is None or not _is_of(file, held_back)]
        parcels = [parcel for file in files if (parcel := _looked_at(file)) and not self._is_confirmed(parcel)]
        return sorted(parcels, key=lambda parcel: (parcel.changed_ns, parcel.name))

    def file(self, parcel: Parcel) -> Path:
        """Where it lies."""
        return self.folder / parcel.name

    def is_unchanged(self, parcel: Parcel) -> bool:
        """Whether it still lies there as it was looked at."""
        return _looked_at(self.file(parcel)) == parcel

    def confirm(self, parcel: Parcel, sha256: str) -> None:
        """The service has it. Raises OSError."""
        place = self._confirmation(parcel)
        place.parent.mkdir(exist_ok=True)
        with whole(place) as beside:
            beside.write_text(json.dumps({**asdict(parcel), "sha256": sha256}))
        self._confirmed.add(parcel)

    def _is_confirmed(self, parcel: Parcel) -> bool:
        if parcel in self._confirmed:
            return True
        try:
            confirmed = json.loads(self._confirmation(parcel).read_text())
            known = bool(confirmed == {**asdict(parcel), "sha256": confirmed["sha256"]})
        except (OSError, ValueError, TypeError, KeyError):
            # Never written, or not whole: then it is sent once more.
            known = False
        if known:
            self._confirmed.add(parcel)
        return known

    def _confirmation(self, parcel: Parcel) -> Path:
        return self.folder / CONFIRMED / f"{parcel.name}.json"


def _is_of(file: Path, demonstration_id: str) -> bool:
    return file.stem == demonstration_id or file.stem.startswith(f"{demonstration_id}-part")


def _looked_at(file: Path) -> Parcel | None:
    try:
        return Parcel.of(file)
    except FileNotFoundError:
        return None  # discarded meanwhile
