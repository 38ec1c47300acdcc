"""Mutated recordings and requests: what comes from outside may be anything, and gets a sentence about itself."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from learner.errors import LearnerError
from learner.observation import observe
from recorder.errors import RecorderError
from recorder.recording import read_recording
from recorder.recovery import recover

LENGTHS = (0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
MISLEADING = ("defect", "Traceback", ".rs:", ".cargo", "panicked", "NoneType")
WORDS = ("", "a", "../x", "A" * 5000, "ä\u202e", "\0", "a b", "none", "*", "$*", "?", "#", "@", "-1", "NaN")


@dataclass
class Answers:
    """What mutated things were answered: how often by which kind, and what should not have been."""

    kinds: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    def add(self, kind: str, sentence: str) -> None:
        """A sentence that was answered, or an empty one where the thing was taken as it is."""
        self.kinds[kind] += 1
        if any(word in sentence for word in MISLEADING) or "\n" in sentence:
            self.wrong.append(sentence[:300])


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """A few bytes turned, cut, doubled, put in, or read as lengths that cannot be."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(0, max(len(data), 1)))
        match int(rng.integers(0, 6)):
            case 0:
                data[at : at + 1] = bytes((int(rng.integers(0, 256)),))
            case 1:
                data[at : at + 8] = LENGTHS[int(rng.integers(0, len(LENGTHS)))].to_bytes(8, "little")
            case 2:
                del data[at:]
            case 3:
                del data[at : at + int(rng.integers(1, 200))]
            case 4:
                data[at:at] = rng.bytes(int(rng.integers(1, 50)))
            case _:
                data[at:at] = data[at : at + int(rng.integers(1, 5000))]
    return bytes(data)


def try_files(whole: Path, folder: Path, count: int, seed: int = 0) -> Answers:
    """Read, observe and recover so many mutations of a recording."""
    rng, content, answers = np.random.default_rng(seed), whole.read_bytes(), Answers()
    for number in range(count):
        file, saved = folder / "mutated.mcap", folder / f"saved-{number}.mcap"
        file.write_bytes(mutated(content, rng))
        answers.add(*_read(file))
        answers.add(*_recovered(file, saved))
        saved.unlink(missing_ok=True)
    return answers


def _read(file: Path) -> tuple[str, str]:
    try:
        observe(read_recording([file]))
    except (RecorderError, LearnerError, OSError) as error:
        return f"read: {type(error).__name__}", str(error)
    except Exception as error:  # noqa: BLE001  # what the test is about
        return "read: defect", f"defect: {type(error).__name__}: {error}"
    return "read: whole", ""


def _recovered(file: Path, saved: Path) -> tuple[str, str]:
    try:
        recover(file, saved)
        read_recording([saved])
    except (RecorderError, LearnerError, OSError) as error:
        return f"recover: {type(error).__name__}", str(error)
    except Exception as error:  # noqa: BLE001  # what the test is about
        return "recover: defect", f"defect: {type(error).__name__}: {error}"
    return "recovered", ""


def requests(template: dict[str, Any], count: int, seed: int = 0) -> Iterator[bytes]:
    """Mutations of a JSON request: values of other types and sizes, keys left out and added, bytes turned."""
    rng = np.random.default_rng(seed)
    odd: list[Any] = [*WORDS, None, True, -1, 0, 1e308, [], {}, [[]], ["A", "A"], {"a": {"b": []}}, 2**70]
    for _ in range(count):
        request = dict(template)
        for _ in range(int(rng.integers(1, 3))):
            key = str(rng.choice([*template, "more"])) if template else "more"
            if rng.random() < 0.2:
                request.pop(key, None)
            else:
                request[key] = odd[int(rng.integers(0, len(odd)))]
        text = json.dumps(request).encode()
        yield mutated(text, rng) if rng.random() < 0.3 else text
