"""The parts of a split demonstration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from recorder.errors import PartMissingError, RecorderError
from recorder.recording.demonstrated import Demonstrated
from recorder.recording.reader import read_header


def sort_parts(files: Sequence[Path]) -> list[Path]:
    """The parts of one split demonstration in their order, or the one file of an unsplit one.

    Raises PartMissingError if one is missing, RecorderError if they are not parts of one demonstration.
    """
    return in_order({file: read_header(file) for file in files})


def in_order(headers: Mapping[Path, Demonstrated]) -> list[Path]:
    """The same by headers that were read. Raises as `sort_parts`."""
    files = list(headers)
    ordered = sorted(files, key=lambda file: headers[file].part or 1)
    numbers = [headers[file].part or 1 for file in ordered]
    identifier = headers[ordered[0]].demonstration_id
    if len({header.demonstration_id for header in headers.values()}) > 1 or len(set(numbers)) < len(numbers):
        raise RecorderError(f"{', '.join(map(str, files))} are not the parts of one demonstration")
    expected = range(1, len(numbers) + (2 if headers[ordered[-1]].continued else 1))
    missing = next((number for number in expected if number not in numbers), None)
    if missing is not None:
        raise PartMissingError(identifier, numbers, missing)
    return ordered


def all_parts(files: Sequence[Path]) -> list[Path]:
    """The parts of one demonstration in their order; of a single part given, those that lie beside it too.

    Raises as `sort_parts`.
    """
    first = read_header(files[0])
    if len(files) > 1 or first.part is None:
        return sort_parts(files)
    return sort_parts([file for file in sorted(files[0].parent.glob("*.mcap")) if _is_part(file, first)] or files)


def _is_part(file: Path, of: Demonstrated) -> bool:
    try:
        return read_header(file).demonstration_id == of.demonstration_id
    except (RecorderError, OSError):
        return False  # whatever it is, it is no part of this one
